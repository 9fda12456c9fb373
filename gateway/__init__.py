"""The gateway service and its tools."""

__version__ = "0.1.0"
