"""`ros2`: the robot in a ROS 2 graph, with one Zenoh session to the gateway and one to ROS 2's router."""
