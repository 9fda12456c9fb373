"""The Elkapod walks ahead, and sits down: velocities go in, and joint angles come out, the same on both sides.

The calibration has the inverted servos; the gateway's settings limit the speed and decide what happens when this
program stalls. See the files in this folder.
"""

import argparse
import time
from pathlib import Path

from gateway.client import DEFAULT_ENDPOINT, Client, GatewayError

GEOMETRY = Path(__file__).with_name("geometry.json")
FORWARD_M_S = 0.1


def main(endpoint: str, seconds: float) -> None:
    with Client(endpoint, source="elkapod gait") as client, client.walk(geometry=GEOMETRY) as robot:
        robot.stand()
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            robot.go(FORWARD_M_S)
        robot.sit()
        print(f"walked {robot.state.odometry.x_m:.2f} m ahead")


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--connect", default=DEFAULT_ENDPOINT, metavar="ENDPOINT")
    arguments.add_argument("--seconds", type=float, default=60.0)
    given = arguments.parse_args()
    try:
        main(given.connect, given.seconds)
    except GatewayError as error:
        raise SystemExit(str(error)) from None
