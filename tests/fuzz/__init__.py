"""Fuzzing of what reads foreign bytes, and the model check of the supervisor."""
