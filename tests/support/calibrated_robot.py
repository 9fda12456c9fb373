"""A robot for the unit tests of `calibrate`: what the gateway would answer, and when."""

import threading
from collections.abc import Callable, Mapping

from gateway.client import Client
from gateway.errors import GatewayError, RejectedError
from gateway.people.client.payloads import Angle
from gateway.people.tools.calibrate.robot import ChangedMeanwhileError, Robot
from gateway.robot.core.calibration import Calibration, Change, ServoCalibration, ServoChange
from schemas.telemetry import Ack, Reason

LATE_S = 20.0
"""For what takes milliseconds on a machine that is not busy."""


class Servos(Client):
    """One running servo, and all that was asked of it. Each answer can be held back, or be an error."""

    def __init__(self) -> None:
        self.asked: list[tuple[object, ...]] = []
        self.running: set[int] = set()
        self.highest_deg = 180.0
        self.answers = {op: threading.Event() for op in ("start", "set", "stop")}
        """Cleared: the answers to these are held back."""
        for event in self.answers.values():
            event.set()
        self.fails: dict[str, GatewayError] = {}
        self._changed = threading.Condition()

    def servo(self, servo_id: int, op: str, angle_deg: Angle | None = None) -> Ack:
        self._note(servo_id, op, angle_deg)
        self._answer(op)
        if op == "set" and servo_id not in self.running:
            return Ack(accepted=False, reason=Reason.SERVO_STOPPED, detail=f"servo {servo_id} does not run")
        if angle_deg is not None and float(angle_deg) > self.highest_deg:
            return Ack(accepted=False, reason=Reason.JOINT_LIMIT, detail=f"{float(angle_deg):g} is outside")
        self.running.add(servo_id)
        return Ack(accepted=True)

    def stop(self, leg: int | None = None) -> Ack:
        self._note(leg, "stop", None)
        self._answer("stop")
        self.running = {servo_id for servo_id in self.running if leg is not None and servo_id // 10 != leg}
        return Ack(accepted=True)

    def wait(self, holds: Callable[[list[tuple[object, ...]]], bool]) -> None:
        """Until what was asked is so."""
        with self._changed:
            assert self._changed.wait_for(lambda: holds(self.asked), LATE_S), self.asked

    def _note(self, *asked: object) -> None:
        with self._changed:
            self.asked.append(asked)
            self._changed.notify_all()

    def _answer(self, op: str) -> None:
        assert self.answers[op].wait(LATE_S)
        if op in self.fails:
            raise self.fails[op]


class KeptCalibration(Robot):
    """The calibration, as the gateway would change it."""

    def __init__(self, calibration: Calibration) -> None:
        self.in_force = calibration
        self.trouble: GatewayError | None = None
        self.answers = threading.Event()
        """Cleared: the answer to who drives is held back."""
        self.answers.set()

    def drive(self) -> None:
        assert self.answers.wait(LATE_S)
        if self.trouble is not None:
            raise self.trouble

    @property
    def drives(self) -> bool:
        return True

    def calibration(self) -> Calibration:
        return self.in_force

    def write(
        self, servos: Mapping[int, ServoCalibration], landing_cdeg: Mapping[int, int | None], revision: int
    ) -> Calibration:
        if self.trouble is not None:
            raise self.trouble
        if revision != self.in_force.revision:
            raise ChangedMeanwhileError(self.in_force)
        change = Change({name: ServoChange(*servo) for name, servo in servos.items()}, landing_cdeg)
        try:
            self.in_force = change.applied_to(self.in_force)
        except ValueError as error:
            raise RejectedError(Reason.INVALID, str(error)) from error
        return self.in_force
