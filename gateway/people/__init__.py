"""The side of people and programs: each part is a Zenoh client like any other."""
