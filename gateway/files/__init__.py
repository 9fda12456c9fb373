"""Files that a power cut leaves whole, and files that nest without end."""
