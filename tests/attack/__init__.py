"""Attacks on the running service, as a stranger would make them; each succeeded once."""
