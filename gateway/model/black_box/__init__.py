"""The black box as its writer and its readers know it: the bytes of its ring, its files, and what an incident is."""
