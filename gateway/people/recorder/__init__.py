"""`record`: what a gateway publishes, as a file, live, or as a table; and what its black box kept of each incident."""
