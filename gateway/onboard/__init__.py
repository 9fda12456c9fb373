"""Commands that run on the robot and know both wings: the service's settings and devices, and what people see."""
