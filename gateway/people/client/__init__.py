"""The parts of `gateway.client`."""
