"""What tests of the ROS 2 bridge share: messages for a robot that lies, and what the gateway wrote for them."""

import os
import time
from collections.abc import Callable
from typing import Final

from gateway.geometry import joint_name, load
from gateway.model.frames import Op
from gateway.model.frames import decode as decode_frame
from gateway.people.ros2.messages import JointState, Message, Twist, Vector3
from schemas.event import FrameRecord
from schemas.robot import SERVO_IDS
from schemas.words import Cause
from tests.support.fixtures import patient
from tests.support.heard import Heard

READY: Final = "is in ROS 2's graph"
GEOMETRY: Final = load()
RESTS_DEG: Final = {1: 90.0, 2: 150.0, 3: 110.0}
"""By joint: how the robot lies."""


def clean() -> dict[str, str]:
    """Return this process's environment, without what ROS would have set."""
    return {name: value for name, value in os.environ.items() if not name.startswith(("ROS_", "RMW_", "FASTDDS_"))}


def resting(**moved_rad: float) -> Message:
    """Return all joints of a lying robot but those that are moved: `resting(joint_11=0.1)`, in radians from there."""
    names = tuple(map(joint_name, SERVO_IDS))
    at_rad = [
        GEOMETRY.joint_rad(servo_id, RESTS_DEG[servo_id % 10]) + moved_rad.get(name, 0.0)
        for servo_id, name in zip(SERVO_IDS, names, strict=True)
    ]
    return JointState(name=names, position=tuple(at_rad))


PATIENT: Final = patient(telemetry={"frames": True})
LONG_S: Final = 40.0
WALKING: Final = Twist(Vector3(0.05))


def keeps(publish: Callable[[], object], until: Callable[[], bool], hz: float = 50) -> None:
    """Publish at a rate until something has come of it."""
    end_s = time.monotonic() + LONG_S
    while not until():
        assert time.monotonic() < end_s, "nothing has come of it"
        publish()
        time.sleep(1 / hz)


def commanded(records: list[FrameRecord], servo_id: int) -> list[float]:
    """Return the angles (degrees) that were written for a servo by commands."""
    return [
        op.angle_cdeg / 100
        for record in records
        if record.cause == Cause.COMMAND
        for each, op in decode_frame(bytes.fromhex(record.bytes)).servos
        if each == servo_id and op.op is not Op.STOP
    ]


def rests(written: Heard[FrameRecord], *servos: int, count: int) -> bool:
    """Return whether the newest `count` angles of each of these are the same."""
    newest = [commanded(written.all[-10 * count :], servo_id)[-count:] for servo_id in servos]
    return all(len(angles) == count and len(set(angles)) == 1 for angles in newest)


def strides(written: Heard[FrameRecord]) -> bool:
    """Return whether leg 1 has swung lately."""
    return len(set(commanded(written.all[-400:], 11))) > 20


def rejections(array: Message) -> str:
    """Return the newest rejections of the bridge, and their reasons."""
    return next((each.value for each in array.status[-1].values if each.key == "latest_rejection"), "")


def does(array: Message) -> str:
    """Return what the bridge reports of itself."""
    return str(array.status[-1].message)
