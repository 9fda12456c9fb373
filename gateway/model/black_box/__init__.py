"""The black box, for its writer and its readers: the bytes of its ring, its files, and its incidents."""
