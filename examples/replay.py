"""Plays a recording (`hexapod-gateway record FILE.mcap`) again: each leg goes where it was commanded to be.

The legs go slowly to the first pose. A recording whose recorder was killed is played as far as it goes.

A leg that was stopped in the recording keeps its last angles until the end, where all legs are stopped.
"""

import argparse
import json
import math
import struct
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import IO, Final

from mcap.exceptions import EndOfFile, McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

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
        for topic, message in messages(recording):
            while due_ns and message.log_time >= due_ns:
                yield pose(joints)
                due_ns += 10**9 // HZ
            joints.take(topic, json.loads(message.data))
            if not due_ns and pose(joints):
                due_ns = message.log_time


def messages(recording: IO[bytes]) -> Iterator[tuple[str, Message]]:
    """The messages in the order of the file, up to its end or to where the recorder was killed."""
    topics: dict[int, str] = {}
    with suppress(EndOfFile, McapError, struct.error):
        for record in StreamReader(recording).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message) and topics[record.channel_id] in (STATE, CALIBRATION, FRAME):
                yield topics[record.channel_id], record


def eased(before: Pose, goal: Pose, deg_s: float) -> Iterator[Pose]:
    """Setpoints from the angles in `before` to `goal`, at most this fast. A leg without angles starts at its goal."""
    starts = goal | {leg: before[leg] for leg in goal.keys() & before.keys()}
    far_deg = max(abs(b - a) for leg in goal for a, b in zip(starts[leg], goal[leg], strict=True))
    steps = max(1, math.ceil(far_deg / deg_s * HZ))
    for step in range(1, steps + 1):
        yield {
            leg: tuple(a + (b - a) * step / steps for a, b in zip(starts[leg], goal[leg], strict=True)) for leg in goal
        }


def pose(joints: CommandedJoints) -> Pose:
    servos = {leg: [10 * leg + joint for joint in (1, 2, 3)] for leg in range(1, 7)}
    return {leg: tuple(joints.deg[each] for each in ids) for leg, ids in servos.items() if joints.deg.keys() >= {*ids}}


def main(file: Path, endpoint: str, real: bool, deg_s: float = 180) -> None:
    count = 0
    with Client(endpoint, source="replay") as robot:
        state = robot.state()
        if not (state.simulated or real):
            raise SystemExit("This is a real robot, and its legs would go to recorded angles. --real moves it.")
        recorded = poses(file)
        if (first := next(recorded, None)) is None:
            raise SystemExit(f"{file} has no commanded leg")
        running = {leg.leg: tuple(a or 0.0 for a in leg.angles_deg) for leg in state.legs if None not in leg.angles_deg}
        with robot.lease(), robot.stream(HZ) as stream:
            for angles in eased(running, first, deg_s):
                stream.set(angles)
            for count, angles in enumerate(chain([first], recorded), start=1):  # noqa: B007
                stream.set(angles)
    print(f"replayed: {count} setpoints in {count / HZ:.1f} s")


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("file", type=Path, metavar="FILE.mcap")
    arguments.add_argument("--connect", default=DEFAULT_ENDPOINT, metavar="ENDPOINT")
    arguments.add_argument("--deg-s", type=float, default=180, help="speed to the first pose: limits.takeover_deg_s")
    arguments.add_argument("--real", action="store_true", help="move a real robot, too")
    given = arguments.parse_args()
    try:
        main(given.file, given.connect, given.real, given.deg_s)
    except GatewayError as error:
        raise SystemExit(str(error)) from None
