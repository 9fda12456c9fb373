"""A gait computed with numpy: an array of (6, 3) in radians for each tick."""

import argparse

import numpy as np

from gateway.client import DEFAULT_ENDPOINT, Client

HZ = 50
REST_RAD = np.radians([90, 60, 120])
PHASE_RAD = np.pi * np.arange(6)[:, np.newaxis]  # legs 1, 3, 5 against legs 2, 4, 6


def main(endpoint: str, seconds: float) -> None:
    swing_rad = np.radians([15, 10, 0])
    with Client(endpoint, source="arrays") as robot, robot.stream(HZ) as stream:
        for tick in range(round(seconds * HZ)):
            stream.set(REST_RAD + swing_rad * np.sin(2 * np.pi * tick / HZ + PHASE_RAD), unit="rad")
        print(np.round(np.degrees(robot.state().angles(unit="rad")), 1))
        print(stream.jitter)


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--connect", default=DEFAULT_ENDPOINT, metavar="ENDPOINT")
    arguments.add_argument("--seconds", type=float, default=5.0)
    given = arguments.parse_args()
    main(given.connect, given.seconds)
