"""What `gateway.client` is made of."""
