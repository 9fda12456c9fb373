"""`walk`: a person at the keyboard drives, or a script gives the velocity."""
