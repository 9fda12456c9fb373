"""Rules of a wire to a controller, pure: time is an argument."""
