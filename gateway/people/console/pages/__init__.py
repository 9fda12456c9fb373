"""What the console does for its pages: their messages, Stops, leases, walks and calibration."""
