"""What is released, from what is committed: `python -m release`. Not part of what is installed."""
