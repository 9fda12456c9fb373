"""What people and programs use; every part of it is a Zenoh client like any other."""
