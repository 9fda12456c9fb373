"""`record`: what a gateway publishes, as a file, live, or as a table."""
