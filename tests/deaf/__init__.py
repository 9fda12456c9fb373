"""What a controller makes of lost bytes and stalls in a minute of traffic: `python -m tests.deaf` tries them all."""
