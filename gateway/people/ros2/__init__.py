"""`ros2`: the robot in a ROS 2 graph, as a node of rclpy. Recordings and incidents have its messages."""
