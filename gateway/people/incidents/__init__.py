"""What the black box kept: read, shown as a story, exported."""
