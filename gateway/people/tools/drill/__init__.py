"""`drill`: proves on this robot, step by step, that it stops, and writes a report of it."""
