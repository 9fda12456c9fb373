"""What the black box kept of each incident: read, found, explained, exported."""
