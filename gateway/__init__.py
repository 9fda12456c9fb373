"""The gateway service and its tools."""

__version__ = "1.1.0"
