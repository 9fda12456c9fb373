"""The keys and payloads on Zenoh."""
