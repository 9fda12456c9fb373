"""What travels on Zenoh: keys and payloads."""
