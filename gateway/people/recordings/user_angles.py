"""The frames of a recording in users' angles. On the wire they have the servos' own, and commands have users'."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from gateway.model.calibration import RobotCalibration, calibration_of
from gateway.model.frames import Frame, FrameError, decode
from gateway.people.recordings.reading import RecordedMessage
from schemas import calibration as wire
from schemas.keys import CALIBRATION, FRAME, STATE


class UserAngles:
    """Reads each frame by the calibration that the recording states was in force when it was written."""

    def __init__(self) -> None:
        self.translated = False
        """Whether any frame has other angles on the wire than its users have."""
        self.consistent = True
        """Whether the calibration that was recorded last is the one that is in force."""
        self._calibration = RobotCalibration()
        self._said = self._contradicted = False

    @property
    def known(self) -> bool:
        """Whether the recording states what was in force all along. One of frames alone does not."""
        return self._said and not self._contradicted

    def frames(self, messages: Iterable[RecordedMessage]) -> Iterator[Mapping[str, Any]]:
        """The FrameRecords in users' angles, as far as the recording states which these are, else as on the wire."""
        for message in messages:
            self.take(message.topic, message.content)
            if message.topic == FRAME:
                yield self.record(message.content)

    def take(self, topic: str, content: Mapping[str, Any]) -> None:
        """A message of the recording, in their order: what it states of calibration holds for all frames after it."""
        if topic == STATE:
            self._said = True
            # An older gateway publishes no calibration, and had none.
            said = content.get("calibration")
            revision = said.get("revision", 0) if isinstance(said, dict) else 0
            self.consistent = revision == self._calibration.revision
        elif topic == CALIBRATION:
            self._said = True
            try:
                self._calibration = calibration_of(wire.Calibration.model_validate(content))
                self.consistent = True
            except ValueError:  # none that a gateway publishes
                self.consistent = False
        self._contradicted |= not self.consistent

    def record(self, record: Mapping[str, Any]) -> Mapping[str, Any]:
        """A FrameRecord in users' angles, as far as known."""
        if not self._calibration.servos:
            return record
        self.translated = True
        try:
            data = bytes.fromhex(record["bytes"])
        except (KeyError, TypeError, ValueError):  # no frame; left as it is
            return record
        return {**record, "bytes": user_bytes(self._calibration, data).hex()}


FrameIn = tuple[RecordedMessage, Frame]
"""A frame of a recording, and the message that has it."""


def frames_in(messages: Iterable[RecordedMessage]) -> Iterator[FrameIn]:
    """Their frames in users' angles, as far as known."""
    angles = UserAngles()
    for message in messages:
        angles.take(message.topic, message.content)
        frame = frame_of(angles.record(message.content)) if message.topic == FRAME else None
        if frame is not None:
            yield message, frame


def frame_of(record: Mapping[str, Any]) -> Frame | None:
    """A FrameRecord's frame; None: it is of a later protocol, or none at all."""
    try:
        return decode(bytes.fromhex(record["bytes"]))
    except (FrameError, ValueError, KeyError, TypeError):
        return None


def user_bytes(calibration: RobotCalibration, data: bytes) -> bytes:
    """A frame's bytes in users' angles; as they are where no user could have meant them."""
    if not calibration.servos:
        return data
    try:
        return calibration.user_frame(decode(data)).to_bytes()
    except FrameError:
        return data
