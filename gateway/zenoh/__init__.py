"""Zenoh's files, sessions, endpoints, and how much a client may take."""
