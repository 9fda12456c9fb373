"""What runs between Zenoh and SPI; it imports nothing of `gateway.people`."""
