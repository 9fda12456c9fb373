"""What a user of ROS 2 would write in place of the gateway, and its publisher. Nothing is checked, no servo stopped.

    python -m tests.benchmarks.rclpy_pair node|publisher DOMAIN HZ AT_ONCE

Each prints `ready`. Then each line on the publisher's standard input is a number of seconds to publish for; it answers
`done`.
"""

import sys
import time
from collections.abc import Callable
from importlib import import_module
from typing import Any

ROLE, DOMAIN, HZ, AT_ONCE = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])
LEGS = range(1, 7)

rclpy: Any = import_module("rclpy")
qos = import_module("rclpy.qos").qos_profile_sensor_data
array = import_module("std_msgs.msg").Float64MultiArray
rclpy.init(domain_id=DOMAIN)
node = rclpy.create_node(f"bench_{ROLE}")


def topic(leg: int) -> str:
    return f"/hexapod/leg{leg}/cmd"


def writer(leg: int) -> Callable[[Any], None]:
    """Return the handler of a leg's messages: three angles in degrees, which become one frame."""

    def write(message: Any) -> None:
        frame = [14, 1]
        for joint, angle in enumerate(message.data, start=1):
            frame += [leg * 10 + joint, 3, int(angle), round(angle % 1 * 100)]
        spi.writebytes2(frame)

    return write


def publish(seconds: float) -> None:
    """Publish each leg's next setpoint in turn, AT_ONCE without a pause, spread evenly over time."""
    begun_s = time.monotonic()
    for number in range(round(seconds * HZ * len(LEGS))):
        time.sleep(max(0.0, begun_s + number // AT_ONCE * AT_ONCE / HZ / len(LEGS) - time.monotonic()))
        publishers[number % len(LEGS)].publish(array(data=[number % 170 + 4.25, 90.0, 90.0]))


if ROLE == "node":
    spi = import_module("spidev").SpiDev()
    spi.open(0, 0)
    spi.max_speed_hz = 2_500_000
    for each in LEGS:
        node.create_subscription(array, topic(each), writer(each), qos)
    print("ready", flush=True)
    rclpy.spin(node)
else:
    publishers = [node.create_publisher(array, topic(leg), qos) for leg in LEGS]
    while not all(publisher.get_subscription_count() for publisher in publishers):
        time.sleep(0.1)
    print("ready", flush=True)
    for line in sys.stdin:
        publish(float(line))
        print("done", flush=True)
