"""Faults made by hand in the modules that keep the robot safe, to see whether the tests notice: `make mutants`."""
