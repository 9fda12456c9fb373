"""The frames of a gateway in users' angles. On the wire they have the servos' own, and commands have users'."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from gateway.model.calibration import RobotCalibration, calibration_of
from gateway.model.frames import Frame, FrameError, decode
from schemas import calibration as wire
from schemas.keys import CALIBRATION, FRAME, STATE


class RecordedMessage(NamedTuple):
    """A message of the gateway's: its key, its JSON, and when it was recorded (ns since 1970)."""

    topic: str
    content: dict[str, Any]
    time_ns: int


class UserAngles:
    """Reads each frame by the calibration that was published before it."""

    def __init__(self) -> None:
        self.consistent = True
        """Whether the calibration that was published last is the one that is in force."""
        self._calibration = RobotCalibration()

    def take(self, topic: str, content: Mapping[str, Any]) -> None:
        """Take a message, in their order: what it states of calibration holds for all frames after it."""
        if topic == STATE:
            # An older gateway publishes no calibration, and had none.
            found = content.get("calibration")
            revision = found.get("revision", 0) if isinstance(found, dict) else 0
            self.consistent = revision == self._calibration.revision
        elif topic == CALIBRATION:
            try:
                self._calibration = calibration_of(wire.Calibration.model_validate(content))
                self.consistent = True
            except ValueError:  # none that a gateway publishes
                self.consistent = False

    def frame(self, record: Mapping[str, Any]) -> Frame | None:
        """Return a FrameRecord's frame in users' angles, as far as known.

        As on the wire where no user could have meant it; None if it is of a later protocol, or none.
        """
        try:
            frame = decode(bytes.fromhex(record["bytes"]))
        except (FrameError, ValueError, KeyError, TypeError):
            return None
        try:
            return self._calibration.user_frame(frame)
        except FrameError:
            return frame


FrameIn = tuple[RecordedMessage, Frame]
"""A frame of a recording, and the message that has it."""


def frames_in(messages: Iterable[RecordedMessage]) -> Iterator[FrameIn]:
    """Their frames in users' angles, as far as known."""
    angles = UserAngles()
    for message in messages:
        angles.take(message.topic, message.content)
        frame = angles.frame(message.content) if message.topic == FRAME else None
        if frame is not None:
            yield message, frame
