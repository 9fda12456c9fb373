"""Simulated controllers, power board, battery and body: they replace the robot in `run --sim`."""
