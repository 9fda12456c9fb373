"""What the black box kept: read, told as a story, exported."""
