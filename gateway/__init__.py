"""The gateway service and its tools."""

from importlib.metadata import version

__version__ = version("hexapod-gateway")
