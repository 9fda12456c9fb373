"""What a stop does to a robot that stands or walks."""
