"""What viewers draw by themselves, as ROS 2's messages: joints, transforms, the robot's description, diagnostics, log,
and what the robot measures.

The joints are where they were commanded to be: nothing comes back from the controller. A servo that was never
commanded is not among the joint states, and stands at 90° in the frames. `/joint_commands` has all joints at the time
of each frame, so that they can be plotted at the rate of the frames: NaN, a gap, where a servo is off. What is off is
marked in 3D, too.

A robot that is simulated with physics is drawn where its body is, in the frame `world`; what was commanded stands
next to it, in frames of the same names that begin with `commanded/`.

`rosbags` writes the messages as bytes (CDR), and their types as text (`ros2msg`).
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from importlib.util import find_spec
from typing import Any, Final

from pydantic import ValidationError

from gateway.geometry import Geometry, transforms
from gateway.geometry.kinematics import BASE, FramePose
from gateway.people.ros2 import messages as ros
from gateway.people.ros2 import robot
from gateway.people.ros2.commanded import CommandedJoints
from gateway.people.ros2.messages import LOG_ERROR, LOG_INFO, LOG_WARN, Message
from gateway.people.watching.dangers import Tone, tone_of
from schemas.gateway_state import GatewayState
from schemas.keys import EVENT, SIM_BODY, STATE, TELEMETRY
from schemas.robot import SERVO_IDS
from schemas.simulation import BodyReport
from schemas.telemetry import Telemetry

INSTALLED: Final = find_spec("rosbags") is not None
"""A robot has no rosbags: it needs NumPy and a dozen more. There incidents are kept without ROS 2's messages."""
if INSTALLED:
    import numpy as np
    from rosbags.interfaces import Nodetype
    from rosbags.typesys import Stores, get_typestore

    _STORE: Final = get_typestore(Stores.ROS2_JAZZY)
    """The types used here are the same in Humble, Jazzy, Kilted and Lyrical."""

JOINT_STATES: Final = "/joint_states"
JOINT_COMMANDS: Final = "/joint_commands"
SIM_JOINT_STATES: Final = "/sim/joint_states"
FRAMES: Final = "/tf"
SERVOS_OFF: Final = "/servos_off"
LOG: Final = "/rosout"
DIAGNOSTICS: Final = "/diagnostics"
DESCRIPTION: Final = "/robot_description"
"""Viewers look for a URDF under this name only."""

DRAWN: Final[Mapping[str, type[Message]]] = {
    JOINT_STATES: ros.JointState,
    JOINT_COMMANDS: ros.JointState,
    SIM_JOINT_STATES: ros.JointState,
    FRAMES: ros.TFMessage,
    SERVOS_OFF: ros.MarkerArray,
    LOG: ros.Log,
    DIAGNOSTICS: ros.DiagnosticArray,
    DESCRIPTION: ros.String,
    **{f"/{name}": kind for name, kind in robot.MEASURED.items()},
}
"""Topic → the type of its messages."""
CAMERAS: Final = "/camera/"
"""The beginning of each camera's topic: ROS 2's CompressedImage. Foxglove's is protobuf; rosbags does not open it."""
WORLD: Final = "world"
COMMANDED: Final = "commanded/"
BODY_NS: Final = 1_000_000_000
"""A simulated body older than this is not drawn: its process has ended."""

PICTURE_PERIOD_NS: Final = 50_000_000
"""Twenty pictures a second: all 24 frames take 4 kB, which at 50 Hz would be most of the file."""

DIAGNOSTICS_PERIOD_NS: Final = 1_000_000_000
MARKS_PERIOD_NS: Final = 1_000_000_000
"""The longest wait of a viewer that connects later. Marks are also drawn at each change."""

Drawn = tuple[str, Message]
"""A topic and a message for it."""


class Drawing:
    """Follow the robot's reports, and return the messages that draw it."""

    def __init__(self, geometry: Geometry) -> None:
        self._geometry = geometry
        self.joints = CommandedJoints(geometry)
        self._drawn: dict[str, tuple[int, object]] = {}
        """By topic (with a period), when it was drawn last (ns), and the value that was shown."""
        self._body: BodyReport | None = None
        self._body_ns = 0

    def take(self, topic: str, report: Mapping[str, Any], time_ns: int) -> Iterator[Drawn]:
        """Return what to draw after a report (parsed JSON, on one of the gateway's keys) received at `time_ns`."""
        shows_joints = self.joints.take(topic, report)
        if topic == EVENT:
            where = "".join(f", {report[name]}" for name in ("source", "key") if report.get(name))
            sentence = f"{report['kind']}: {report['detail']}{where}"
            yield LOG, log_line(_LEVELS[tone_of(report["kind"])], sentence, time_ns)
        elif topic == STATE:
            yield from self.picture(time_ns)
            if self._due(DIAGNOSTICS, time_ns, DIAGNOSTICS_PERIOD_NS, report["mode"]):
                with suppress(ValidationError):  # of another release
                    found = robot.diagnostics(GatewayState.model_validate(report))
                    yield DIAGNOSTICS, robot.diagnostic_array(found, time_ns)
        elif topic == TELEMETRY:
            for name, message in robot.measured(Telemetry.model_validate(report), time_ns):
                yield f"/{name}", message
        elif topic == SIM_BODY:
            self._body, self._body_ns = BodyReport.model_validate(report), time_ns
        is_motion = topic == SIM_BODY or (shows_joints and topic != STATE)
        if is_motion and self._due(FRAMES, time_ns, PICTURE_PERIOD_NS):
            yield from self.picture(time_ns)
        if shows_joints:
            rad, running = self.joints.rad, self.joints.running
            at_rad = {each: rad.get(each, math.nan) if running.get(each) else math.nan for each in SERVO_IDS}
            yield JOINT_COMMANDS, robot.joint_state(at_rad, time_ns)
            yield from self._marks_if_due(time_ns)

    def _due(self, topic: str, time_ns: int, period_ns: int, shown: object = None) -> bool:
        """Return whether to draw the topic again: its period has passed, or `shown` has changed."""
        before = self._drawn.get(topic)
        if before is not None and time_ns - before[0] < period_ns and shown == before[1]:
            return False
        self._drawn[topic] = time_ns, shown
        return True

    def _marks_if_due(self, time_ns: int) -> Iterator[Drawn]:
        running = dict(self.joints.running)
        if self._due(SERVOS_OFF, time_ns, MARKS_PERIOD_NS, running):
            yield SERVOS_OFF, robot.servos_off([each for each, runs in running.items() if not runs], time_ns)

    def picture(self, time_ns: int) -> Iterator[Drawn]:
        """Return the robot as last commanded, and its simulated body if that is recent."""
        self._drawn[FRAMES] = time_ns, None
        body = self._body if time_ns - self._body_ns < BODY_NS else None
        commanded_rad = robot.all_at(self._geometry, robot.UNKNOWN_DEG) | self.joints.rad
        yield JOINT_STATES, robot.joint_state(self.joints.rad, time_ns)
        yield from self._marks_if_due(time_ns)
        if body is None:
            steps = list(transforms(self._geometry, commanded_rad))
        else:
            true_rad = {
                int(name): self._geometry.joint_rad(int(name), servo.angle_deg) for name, servo in body.servos.items()
            }
            yield SIM_JOINT_STATES, robot.joint_state(true_rad, time_ns)
            steps = [
                FramePose(WORLD, BASE, body.position_m, body.orientation_xyzw),
                *transforms(self._geometry, true_rad),
                FramePose(BASE, COMMANDED + BASE, (0, 0, 0), (0, 0, 0, 1)),
                *(
                    step._replace(parent=COMMANDED + step.parent, child=COMMANDED + step.child)
                    for step in transforms(self._geometry, commanded_rad)
                ),
            ]
        yield FRAMES, robot.transform_message(steps, time_ns)

    def description(self) -> Drawn:
        """Return the URDF as the message that viewers read."""
        return DESCRIPTION, robot.description(self._geometry)

    def camera(self, topic: str, jpeg: bytes, taken_ns: int) -> Drawn:
        """Return a camera's picture."""
        return topic, ros.CompressedImage(ros.Header(robot.stamp(taken_ns), topic.strip("/")), "jpeg", memoryview(jpeg))


_LEVELS: Final[dict[Tone, int]] = {"bad": LOG_ERROR, "warn": LOG_WARN, "plain": LOG_INFO}


def log_line(level: int, sentence: str, time_ns: int) -> Message:
    """Return a line for the viewers' log."""
    return ros.Log(robot.stamp(time_ns), level, "hexapod-gateway", sentence.replace("\0", "\ufffd"))


# ---- as bytes


def encode(message: Message) -> bytes:
    """Return the message's bytes, with the encapsulation. Raises ValueError if a value does not fit its field."""
    try:
        return bytes(_STORE.serialize_cdr(_made(message.TYPE, message), message.TYPE))
    except Exception as error:  # rosbags' own, struct's, numpy's
        raise ValueError(f"{message.TYPE} cannot be written: {error}") from error


def definition(kind: type[Message]) -> str:
    """Return the type's fields as text, and those of every type inside it: any program can read a message by it."""
    return _STORE.generate_msgdef(kind.TYPE, ros_version=2)[0]


def _made(type_name: str, message: Message | None) -> Any:
    """rosbags' own message with these fields; the others have ROS 2's defaults."""
    _, fields = _STORE.fielddefs[type_name]
    return _STORE.types[type_name](**{name: _value(kind, getattr(message, name, None)) for name, kind in fields})


def _value(kind: Any, value: Any) -> Any:
    node, what = kind
    if node == Nodetype.NAME:
        return _made(what, value)
    if node == Nodetype.BASE:
        return value if value is not None else "" if what[0] == "string" else False if what[0] == "bool" else 0
    (inner, element), count = what
    if inner == Nodetype.BASE and element[0] != "string":
        return np.array(value if value is not None else (0,) * count, dtype=element[0])
    return [_value((inner, element), each) for each in value or ()]
