"""Checks changes of the calibration, has them saved to the disk, and then puts them in force. Pure.

A change takes two steps, since no Stop may wait for a disk. `Calibrate` is checked, and the new calibration is saved
(`SaveCalibration`) while the old one stays in force. `CalibrationSaved` puts it in force, or, after a disk fault, drops
it.

A servo's calibration must not change while the servo runs: the servo would jump at the next frame. So a change is
rejected if one of its servos runs or waits to be started, and none of them can be started until it is in force.

If the calibration file cannot be read (`fault`), nothing moves until a person accepts the default
calibration, or imports a good one: with a wrong trim or direction, a leg would move to an angle that was not commanded.
"""

from typing import Any, Final

from gateway.model.calibration import CalibrationError, RobotCalibration, changed, changed_servos
from gateway.robot.core.events import (
    Announce,
    Calibrate,
    CalibrationSaved,
    Completed,
    Effect,
    Rejected,
    SaveCalibration,
)
from gateway.robot.core.interlock import Interlock, Why
from gateway.robot.core.legs import Legs
from gateway.robot.core.rules import Rules
from schemas.calibration import CalibrationCommand
from schemas.words import Kind, Reason

UNTIL_TRUSTED: Final = "until a good calibration is imported, or the default accepted"
"""What a person does about a calibration that cannot be trusted, by the command `calibrate`."""
_UNTRUSTED: Final = f"{{}}; nothing is started {UNTIL_TRUSTED}, by `calibrate`"


class Calibrating(Interlock[Calibrate | CalibrationSaved]):
    """One robot's calibration, and the change that is being saved."""

    takes = (Calibrate, CalibrationSaved)

    def __init__(self, rules: Rules, legs: Legs) -> None:
        super().__init__(rules, legs)
        self._limits = legs.limits
        self.fault: str | None = None
        """Why the calibration cannot be trusted, or None."""
        self.saving: tuple[Calibrate, RobotCalibration] | None = None
        """An accepted change that is not saved yet, and the calibration with it."""

    @property
    def in_force(self) -> RobotCalibration:
        """The calibration of the frames that are written now."""
        return self._limits.calibration

    def load(self, calibration: RobotCalibration, fault: str | None = None) -> None:
        """Put it in force; `fault` is why it cannot be trusted. Servos that it changes must be stopped."""
        self._limits.use(calibration)
        self.fault = fault
        self.closed = fault is not None

    def why_not(self, request: Any) -> Why | None:
        if self.fault is not None:
            return Reason.SERVO_STOPPED, _UNTRUSTED.format(self.fault)
        for servo_id, _ in request.moves:
            if self.saving is not None and self.saving[1].of(servo_id) != self.in_force.of(servo_id):
                return Reason.SERVO_STOPPED, f"servo {servo_id} is being calibrated; start it once the change is saved"
        return None

    def take(self, event: Calibrate | CalibrationSaved, now_ns: int) -> list[Effect]:  # noqa: ARG002
        return self._kept(event) if isinstance(event, CalibrationSaved) else self._change(event)

    def _change(self, event: Calibrate) -> list[Effect]:
        """Check a change. The supervisor has checked the mode and other interlocks."""
        rejection = self._why_not_now(event.change)
        if rejection is not None:
            return [Rejected(event, *rejection)]
        before = RobotCalibration(self.in_force.revision) if event.change.accept_default else self.in_force
        try:
            calibration = changed(before, event.change)
        except CalibrationError as error:
            return [Rejected(event, Reason.INVALID, str(error))]
        for servo_id, angle_cdeg in calibration.landing_cdeg.items():
            why_not = self._limits.why_avoided(calibration, servo_id, angle_cdeg)
            if why_not is not None:
                return [Rejected(event, Reason.JOINT_LIMIT, f"the landing pose cannot be sent: {why_not}")]
        for servo_id in changed_servos(self.in_force, calibration):
            if self._legs.servos[servo_id].will_run:
                detail = f"servo {servo_id} runs or waits to be started; stop it before its calibration is changed"
                return [Rejected(event, Reason.INVALID, detail)]
        self.saving = event, calibration
        self.closed = True
        return [SaveCalibration(event.number, calibration)]

    def _why_not_now(self, change: CalibrationCommand) -> Why | None:
        if self.saving is not None:
            return Reason.STALE, "another change of the calibration is being saved; read it then, and change it again"
        revision = self.in_force.revision
        if change.revision not in (None, revision):
            return Reason.STALE, f"revision {change.revision} is changed, and {revision} is in force; look at it first"
        if self.fault is not None and not change.accept_default:
            return Reason.SERVO_STOPPED, _UNTRUSTED.format(self.fault)
        if self.fault is None and change.accept_default:
            return Reason.INVALID, "accept_default is for a calibration that cannot be read; this one can"
        return None

    def _kept(self, event: CalibrationSaved) -> list[Effect]:  # mutants accepted (Forget): only time is lost
        """Put the saved change in force, or reject it and keep the old calibration if the disk failed."""
        if self.saving is None or self.saving[0].number != event.number:
            return []  # nobody waits for it
        (asked, calibration), self.saving = self.saving, None
        if event.fault is not None:
            self.closed = self.fault is not None
            return [Rejected(asked, Reason.INVALID, event.fault)]
        parts = [f"servo {servo_id}" for servo_id in changed_servos(self.in_force, calibration)]
        parts += ["the landing pose"] * (calibration.landing_cdeg != self.in_force.landing_cdeg)
        self.load(calibration)
        detail = f"calibration {calibration.revision} is in force; it changes {', '.join(parts) or 'nothing'}"
        if asked.change.accept_default:
            detail = f"the default calibration is taken as this robot's; {detail}"
        changed = Announce(Kind.CALIBRATED, detail, asked.source, asked.key, source_id=asked.source_id)
        return [changed, Completed(asked)]
