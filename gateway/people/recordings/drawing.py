"""What Foxglove and Lichtblick draw by themselves: joint states, frames, log lines and the robot's description.

The joints are where they were commanded to be: nothing comes back from the controller. A servo that was never
commanded is not among the joint states, and stands at 90° in the frames.

A robot that is simulated with physics is drawn where its body is, in the frame `world`; what was commanded stands
beside it, in frames of the same names behind `commanded/`.
"""

from collections.abc import Iterator, Mapping
from typing import Any, Final

from gateway.geometry import Geometry, joint_name, transforms, urdf
from gateway.geometry.kinematics import BASE, Transform
from gateway.people.recordings.commanded import CommandedJoints
from schemas.keys import EVENT, SIM_BODY, STATE
from schemas.robot import SERVO_IDS
from schemas.telemetry import BodyReport, Kind

JOINT_STATES: Final = "/joint_states"
SIM_JOINT_STATES: Final = "/sim/joint_states"
FRAMES: Final = "/tf"
LOG: Final = "/log"
DESCRIPTION: Final = "/robot_description"
"""Viewers look for a URDF under this name only."""

UNKNOWN_DEG: Final = 90.0
WORLD: Final = "world"
COMMANDED: Final = "commanded/"
BODY_NS: Final = 1_000_000_000
"""A simulated body that is older than this is not drawn: its process has ended."""

PICTURE_PERIOD_NS: Final = 50_000_000
"""Twenty pictures a second: all 24 frames take 4 kB, which at 50 Hz would be most of the file."""

Json = dict[str, Any]
Drawn = tuple[str, Json]
"""A topic and a message for it."""


class Drawing:
    """Follows the robot's reports, and draws it from them."""

    def __init__(self, geometry: Geometry) -> None:
        self._geometry = geometry
        self._joints = CommandedJoints(geometry)
        self._drawn_ns: int | None = None
        self._body: BodyReport | None = None
        self._body_ns = 0

    def take(self, topic: str, report: Mapping[str, Any], time_ns: int) -> Iterator[Drawn]:
        """What to draw after a report (as its JSON, on a key of ours) that came at `time_ns`."""
        moved = self._joints.take(topic, report)
        if topic == EVENT:
            yield LOG, _log(report, time_ns)
        elif topic == STATE:
            yield from self.picture(time_ns)
        elif topic == SIM_BODY:
            self._body, self._body_ns = BodyReport.model_validate(report), time_ns
            yield from self._picture_if_due(time_ns)
        elif moved:
            yield from self._picture_if_due(time_ns)

    def _picture_if_due(self, time_ns: int) -> Iterator[Drawn]:
        if self._drawn_ns is None or time_ns - self._drawn_ns >= PICTURE_PERIOD_NS:
            yield from self.picture(time_ns)

    def picture(self, time_ns: int) -> Iterator[Drawn]:
        """The robot as it was commanded last."""
        self._drawn_ns = time_ns
        stamp = _stamp(time_ns)
        body = self._body if time_ns - self._body_ns < BODY_NS else None
        commanded_rad = {
            servo_id: self._joints.rad.get(servo_id, self._geometry.joint_rad(servo_id, UNKNOWN_DEG))
            for servo_id in SERVO_IDS
        }
        yield JOINT_STATES, _joint_states(self._joints.rad, stamp)
        if body is None:
            steps = list(transforms(self._geometry, commanded_rad))
        else:
            true_rad = {
                int(name): self._geometry.joint_rad(int(name), servo.angle_deg) for name, servo in body.servos.items()
            }
            yield SIM_JOINT_STATES, _joint_states(true_rad, stamp)
            steps = [
                Transform(WORLD, BASE, body.position_m, body.orientation_xyzw),
                *transforms(self._geometry, true_rad),
                Transform(BASE, COMMANDED + BASE, (0, 0, 0), (0, 0, 0, 1)),
                *(
                    step._replace(parent=COMMANDED + step.parent, child=COMMANDED + step.child)
                    for step in transforms(self._geometry, commanded_rad)
                ),
            ]
        yield (
            FRAMES,
            {
                "transforms": [
                    {
                        "timestamp": stamp,
                        "parent_frame_id": step.parent,
                        "child_frame_id": step.child,
                        "translation": _named("xyz", step.translation_m),
                        "rotation": _named("xyzw", step.rotation),
                    }
                    for step in steps
                ]
            },
        )

    def description(self) -> Drawn:
        """The URDF, in the one message that viewers look for."""
        return DESCRIPTION, {"data": urdf(self._geometry)}


def _joint_states(joints_rad: Mapping[int, float], stamp: Json) -> Json:
    joints = [
        {"name": joint_name(servo_id), "position": round(joints_rad[servo_id], 5)} for servo_id in sorted(joints_rad)
    ]
    return {"timestamp": stamp, "joints": joints}


def _named(names: str, values: tuple[float, ...]) -> dict[str, float]:
    return {name: round(value, 5) for name, value in zip(names, values, strict=True)}


def _stamp(time_ns: int) -> dict[str, int]:
    sec, nsec = divmod(time_ns, 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


_INFO, _WARNING, _ERROR = 2, 3, 4
_LEVELS: Final = {
    Kind.COMMAND_REJECTED: _WARNING,
    Kind.WATCHDOG_EXPIRED: _WARNING,
    Kind.STOPPED_OUTSIDE: _WARNING,
    Kind.ESTOP_ENGAGED: _ERROR,
    Kind.BUS_FAULT: _ERROR,
}


def warning(sentence: str, time_ns: int) -> Json:
    """A line of the log that is no event of the gateway's."""
    return {
        "timestamp": _stamp(time_ns),
        "level": _WARNING,
        "message": sentence,
        "name": "hexapod-gateway",
        "file": "",
        "line": 0,
    }


def _log(event: Mapping[str, Any], time_ns: int) -> Json:
    where = "".join(f", {event[name]}" for name in ("source", "key") if event.get(name))
    line = warning(f"{event['kind']}: {event['detail']}{where}", time_ns)
    return {**line, "level": _LEVELS.get(event["kind"], _INFO)}


# ---- the schemas of what is drawn, as https://docs.foxglove.dev/docs/sdk/schemas names their fields

_NUMBER: Final[Json] = {"type": "number"}
_TEXT: Final[Json] = {"type": "string"}
_COUNT: Final[Json] = {"type": "integer", "minimum": 0}


def _object(title: str, required: tuple[str, ...] | None = None, **members: Json) -> Json:
    wanted = list(members if required is None else required)
    return {"title": title, "type": "object", "properties": members, "required": wanted}


def _list(items: Json) -> Json:
    return {"type": "array", "items": items}


_TIME: Final = _object("time", sec=_COUNT, nsec={**_COUNT, "maximum": 999_999_999})
_VECTOR: Final = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION: Final = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_LEVEL_NAMES: Final = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")

_JOINT_STATES: Final = _object(
    "foxglove.JointStates",
    timestamp=_TIME,
    joints=_list(_object("foxglove.JointState", ("name",), name=_TEXT, position=_NUMBER)),
)

DRAWN_SCHEMAS: Final[dict[str, Json]] = {
    JOINT_STATES: _JOINT_STATES,
    SIM_JOINT_STATES: _JOINT_STATES,
    FRAMES: _object(
        "foxglove.FrameTransforms",
        transforms=_list(
            _object(
                "foxglove.FrameTransform",
                timestamp=_TIME,
                parent_frame_id=_TEXT,
                child_frame_id=_TEXT,
                translation=_VECTOR,
                rotation=_QUATERNION,
            )
        ),
    ),
    LOG: _object(
        "foxglove.Log",
        timestamp=_TIME,
        level={"oneOf": [{"title": name, "const": number} for number, name in enumerate(_LEVEL_NAMES)]},
        message=_TEXT,
        name=_TEXT,
        file=_TEXT,
        line=_COUNT,
    ),
    DESCRIPTION: _object("std_msgs/String", data=_TEXT),
}
"""Topic → JSON Schema; its title is the name by which viewers know it."""
