"""`walk`: a person at the keyboard drives, or a script says where to."""
