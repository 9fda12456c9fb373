"""The board on CAN that switches each servo's supply: the second, confirmed way to stop."""
