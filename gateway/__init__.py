"""The gateway service and its tools."""
