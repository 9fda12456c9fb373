"""Simulated controllers, power board, battery and body: what `run --sim` puts in a robot's place."""
