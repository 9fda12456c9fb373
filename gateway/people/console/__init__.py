"""The console: a web page that shows the robot and drives it, served by a process that is one more Zenoh client."""
