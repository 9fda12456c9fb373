"""Where each joint was commanded to be, from what a gateway publishes. Nothing comes back from the controller.

On the wire frames have the servos' own angles, and commands have users'.
"""

from collections.abc import Mapping
from typing import Any

from gateway.geometry import Geometry
from gateway.model.calibration import RobotCalibration, calibration_of
from gateway.model.frames import Frame, FrameError, Op, decode
from schemas import calibration as wire
from schemas.keys import CALIBRATION, FRAME, STATE


class UserAngles:
    """Reads each frame by the calibration that was published before it."""

    def __init__(self) -> None:
        self.consistent = True
        """Whether the last published calibration is the one in force."""
        self._calibration = RobotCalibration()

    def take(self, topic: str, content: Mapping[str, Any]) -> None:
        """Take the next message in order. A calibration in it applies to all later frames."""
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

        Wire angles are kept if no user's angle matches them. None: no frame, or one of a later protocol.
        """
        try:
            frame = decode(bytes.fromhex(record["bytes"]))
        except (FrameError, ValueError, KeyError, TypeError):
            return None
        try:
            return self._calibration.user_frame(frame)
        except FrameError:
            return frame


class CommandedJoints:
    """Track each servo's last command from states and, if published, frames."""

    def __init__(self, geometry: Geometry) -> None:
        self._geometry = geometry
        self._angles = UserAngles()
        self.deg: dict[int, float] = {}
        """Users' angles by servo, without servos that were never commanded. A stopped servo keeps its last angle."""
        self.rad: dict[int, float] = {}
        """The same as angles of the robot's joints."""
        self.running: dict[int, bool] = {}
        """Whether each servo runs; only servos that a report contained."""

    def take(self, topic: str, report: Mapping[str, Any]) -> bool:
        """Take a report (parsed JSON, on one of the gateway's keys). Return whether it contains joint angles."""
        self._angles.take(topic, report)
        if topic == STATE:
            for leg in report["legs"]:
                for servo in leg["servos"]:
                    self._commanded(servo["id"], servo.get("angle_deg"))
                    self.running[servo["id"]] = bool(servo["running"])
            return True
        if topic == FRAME and self._angles.consistent:  # else the state alone shows where it is
            frame = self._angles.frame(report)
            for servo_id, command in () if frame is None else frame.servos:
                self.running[servo_id] = command.op is not Op.STOP
                if self.running[servo_id]:
                    self._commanded(servo_id, command.angle_cdeg / 100)
            return True
        return False

    def _commanded(self, servo_id: int, angle_deg: float | None) -> None:
        if angle_deg is not None and servo_id in self._geometry.servos:
            self.deg[servo_id] = angle_deg
            self.rad[servo_id] = self._geometry.joint_rad(servo_id, angle_deg)
