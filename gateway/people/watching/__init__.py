"""What pages, `status` and the walk's screen watch: reports, silence, confirmed Stops, dangers."""
