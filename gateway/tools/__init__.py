"""Command-line tools beside the service."""
