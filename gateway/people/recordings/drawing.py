"""What Foxglove and Lichtblick draw by themselves: joint states, frames, log lines and the robot's description.

The joints are where they were commanded to be: nothing comes back from the controller. A servo that was never
commanded is not among the joint states, and stands at 90° in the frames.
"""

from collections.abc import Iterator, Mapping
from typing import Any, Final

from gateway.geometry import Geometry, joint_name, transforms, urdf
from gateway.people.recordings.user_angles import UserAngles
from gateway.robot.protocol.frames import FrameError, Op
from gateway.robot.protocol.frames import decode as decode_frame
from schemas.keys import EVENT, FRAME, STATE
from schemas.robot import SERVO_IDS
from schemas.telemetry import Kind

JOINT_STATES: Final = "/joint_states"
FRAMES: Final = "/tf"
LOG: Final = "/log"
DESCRIPTION: Final = "/robot_description"
"""Viewers look for a URDF under this name only."""

UNKNOWN_DEG: Final = 90.0

PICTURE_PERIOD_NS: Final = 50_000_000
"""Twenty pictures a second: all 24 frames take 4 kB, which at 50 Hz would be most of the file."""

Json = dict[str, Any]
Drawn = tuple[str, Json]
"""A topic and a message for it."""


class Drawing:
    """Follows the robot's reports, and draws it from them."""

    def __init__(self, geometry: Geometry) -> None:
        self._geometry = geometry
        self._commanded_rad: dict[int, float] = {}
        self._drawn_ns: int | None = None
        self._angles = UserAngles()

    def take(self, topic: str, report: Mapping[str, Any], time_ns: int) -> Iterator[Drawn]:
        """What to draw after a report (as its JSON, on a key of ours) that came at `time_ns`."""
        self._angles.hear(topic, report)
        if topic == EVENT:
            yield LOG, _log(report, time_ns)
        elif topic == STATE:
            for leg in report["legs"]:
                for servo in leg["servos"]:
                    self._commanded(servo["id"], servo.get("angle_deg"))
            yield from self.picture(time_ns)
        elif topic == FRAME and self._angles.consistent:  # else the state alone says where it is
            self._take_frame(self._angles.record(report)["bytes"])
            if self._drawn_ns is None or time_ns - self._drawn_ns >= PICTURE_PERIOD_NS:
                yield from self.picture(time_ns)

    def picture(self, time_ns: int) -> Iterator[Drawn]:
        """The robot as it was commanded last."""
        self._drawn_ns = time_ns
        stamp = _stamp(time_ns)
        yield (
            JOINT_STATES,
            {
                "timestamp": stamp,
                "joints": [
                    {"name": joint_name(servo_id), "position": round(self._commanded_rad[servo_id], 5)}
                    for servo_id in SERVO_IDS
                    if servo_id in self._commanded_rad
                ],
            },
        )
        joints_rad = {
            servo_id: self._commanded_rad.get(servo_id, self._geometry.joint_rad(servo_id, UNKNOWN_DEG))
            for servo_id in SERVO_IDS
        }
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
                    for step in transforms(self._geometry, joints_rad)
                ]
            },
        )

    def description(self) -> Drawn:
        """The URDF, in the one message that viewers look for."""
        return DESCRIPTION, {"data": urdf(self._geometry)}

    def _take_frame(self, hex_bytes: str) -> None:
        try:
            frame = decode_frame(bytes.fromhex(hex_bytes))
        except (FrameError, ValueError):  # of a later protocol
            return
        for servo_id, command in frame.servos:
            if command.op is not Op.STOP:
                self._commanded(servo_id, command.angle_cdeg / 100)

    def _commanded(self, servo_id: int, angle_deg: float | None) -> None:
        if angle_deg is not None and servo_id in self._geometry.servos:
            self._commanded_rad[servo_id] = self._geometry.joint_rad(servo_id, angle_deg)


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

DRAWN_SCHEMAS: Final[dict[str, Json]] = {
    JOINT_STATES: _object(
        "foxglove.JointStates",
        timestamp=_TIME,
        joints=_list(_object("foxglove.JointState", ("name",), name=_TEXT, position=_NUMBER)),
    ),
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
