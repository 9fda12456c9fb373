"""Walks the robot for some seconds from any ROS 2, over any RMW, with a running `hexapod-gateway ros2`.

python walk.py --ros-args -r __ns:=/hexapod
"""

import time

import rclpy
from geometry_msgs.msg import Twist
from rclpy.node import Node
from std_srvs.srv import Trigger


def call(node: Node, service: str) -> bool:
    """Whether it was done; prints the answer."""
    client = node.create_client(Trigger, service)
    client.wait_for_service()
    future = client.call_async(Trigger.Request())
    rclpy.spin_until_future_complete(node, future)
    print(f"{service}: {future.result().message}")
    return bool(future.result().success)


def main() -> None:
    """Take the lease, stand up and walk, sit down, give it back."""
    rclpy.init()
    node = rclpy.create_node("walker")
    publisher = node.create_publisher(Twist, "cmd_vel", 10)
    forward = Twist()
    forward.linear.x = 0.05
    if not call(node, "drive"):
        return
    end_s = time.monotonic() + 8  # it stands up first
    while time.monotonic() < end_s:
        publisher.publish(forward)  # each holds for half a second
        time.sleep(0.05)
    call(node, "release")


if __name__ == "__main__":
    main()
