"""Commands that run on the robot and use both sides: the service's settings and devices, and the people's tools."""
