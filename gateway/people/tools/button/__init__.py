"""`button`: a terminal that is a stop button."""
