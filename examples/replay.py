"""Plays a recording (`hexapod-gateway record FILE.mcap`) again: each leg goes where it was commanded to be.

A leg that was stopped in the recording keeps its last angles until the end, where all legs are stopped.
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from mcap.reader import make_reader

from gateway.client import DEFAULT_ENDPOINT, Client, GatewayError
from gateway.geometry import load
from gateway.people.ros2.commanded import CommandedJoints
from schemas.keys import CALIBRATION, FRAME, STATE

HZ: Final = 50
Pose = dict[int, tuple[float, ...]]


def poses(file: Path) -> Iterator[Pose]:
    """Leg → degrees of its three joints, 50 times a second, from the first leg that was commanded."""
    joints, due_ns = CommandedJoints(load()), 0
    with file.open("rb") as recording:
        for _, channel, message in make_reader(recording).iter_messages([STATE, CALIBRATION, FRAME]):
            while due_ns and message.log_time >= due_ns:
                yield pose(joints)
                due_ns += 10**9 // HZ
            joints.take(channel.topic, json.loads(message.data))
            if not due_ns and pose(joints):
                due_ns = message.log_time


def pose(joints: CommandedJoints) -> Pose:
    servos = {leg: [10 * leg + joint for joint in (1, 2, 3)] for leg in range(1, 7)}
    return {leg: tuple(joints.deg[each] for each in ids) for leg, ids in servos.items() if joints.deg.keys() >= {*ids}}


def main(file: Path, endpoint: str, real: bool) -> None:
    count = 0
    with Client(endpoint, source="replay") as robot:
        if not (robot.state().simulated or real):
            raise SystemExit("This is a real robot: its legs would go to the first pose at once. --real moves it.")
        with robot.lease(), robot.stream(HZ) as stream:
            for count, angles in enumerate(poses(file), start=1):  # noqa: B007
                stream.set(angles)
    print(f"replayed: {count} setpoints in {count / HZ:.1f} s")


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("file", type=Path, metavar="FILE.mcap")
    arguments.add_argument("--connect", default=DEFAULT_ENDPOINT, metavar="ENDPOINT")
    arguments.add_argument("--real", action="store_true", help="move a real robot, too")
    given = arguments.parse_args()
    try:
        main(given.file, given.connect, given.real)
    except GatewayError as error:
        raise SystemExit(str(error)) from None
