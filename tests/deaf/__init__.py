"""What a controller makes of lost bytes in a minute of traffic (tests/attack/test_deaf_controller.py)."""
