"""It walks: a tripod gait, all 18 servos 50 times a second; velocities go in, and angles come out.

Each failure has its own error: StoppedError (somebody, or the watchdog, stopped a leg; a person decides whether to go
on, `--start-again`), LeaseError (somebody else drives), WalkError (these legs cannot do that).
At the end of its `with` it sits down, and its servos are stopped.
"""

import argparse
import time

from gateway.client import DEFAULT_ENDPOINT, Client, GatewayError, StoppedError, Walk


def walk(robot: Walk, seconds: float) -> None:
    """Ahead in a slow curve."""
    robot.stand()
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        robot.go(forward_m_s=0.08, turn_rad_s=0.1)


def main(endpoint: str, seconds: float, start_again: bool) -> None:
    with Client(endpoint, source="tripod gait") as client, client.walk(gait="tripod") as robot:  # it holds the lease
        try:
            walk(robot, seconds)
        except StoppedError as stopped:
            if not start_again:
                raise
            print(f"starting again: {stopped}")
            robot.start_again()
            walk(robot, seconds)
        print("walked {:.2f} m ahead, {:.2f} m to the left, turned by {:.2f} rad".format(*robot.state.odometry))


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--connect", default=DEFAULT_ENDPOINT, metavar="ENDPOINT")
    arguments.add_argument("--seconds", type=float, default=10.0)
    arguments.add_argument("--start-again", action="store_true", help="go on by itself when something stopped a leg")
    given = arguments.parse_args()
    try:
        main(given.connect, given.seconds, given.start_again)
    except GatewayError as error:
        raise SystemExit(str(error)) from None
