"""The service between Zenoh and SPI. Nothing here imports `gateway.people`."""
