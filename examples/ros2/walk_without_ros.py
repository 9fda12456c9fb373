"""Walks the robot for some seconds from a program that has no ROS, over rmw_zenoh; beside `hexapod-gateway ros2`.

pip install zenoh-ros2-sdk && python walk_without_ros.py [ROUTER_PORT]
"""

import sys
import time

from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient

VECTOR = "=" * 80 + "\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
TWIST = f"Vector3 linear\nVector3 angular\n{VECTOR}"
TWIST_HASH = "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
TRIGGER_HASH = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"


def call(port: int, service: str) -> bool:
    """Whether it was done; prints the answer."""
    client = ROS2ServiceClient(
        f"/hexapod/{service}",
        "std_srvs/srv/Trigger",
        "\n",
        "bool success\nstring message\n",
        router_port=port,
        type_hash=TRIGGER_HASH,
        timeout=20,  # sitting down takes some seconds
    )
    answer = client.call()
    client.close()
    print(f"{service}: {answer.message if answer else 'no answer'}")
    return bool(answer and answer.success)


def main() -> None:
    """Take the lease, stand up and walk, sit down, give it back."""
    port = int(sys.argv[1]) if sys.argv[1:] else 7447
    velocities = ROS2Publisher(
        "/hexapod/cmd_vel", "geometry_msgs/msg/Twist", TWIST, router_port=port, type_hash=TWIST_HASH
    )
    vector = velocities.session_mgr.store.types["geometry_msgs/msg/Vector3"]
    forward, straight = vector(x=0.05, y=0.0, z=0.0), vector(x=0.0, y=0.0, z=0.0)
    if not call(port, "drive"):
        return
    end_s = time.monotonic() + 8  # it stands up first
    while time.monotonic() < end_s:
        velocities.publish(linear=forward, angular=straight)  # each holds for half a second
        time.sleep(0.05)
    call(port, "release")


if __name__ == "__main__":
    main()
