"""Servos, angles, frames, calibrations, limits and black-box records, for the robot's and the people's side. Pure."""
