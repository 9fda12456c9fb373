"""The robot of `calibrate`: its calibration read and written, and the lease without which nothing is moved."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack

from gateway.errors import GatewayError, LeaseLostError, RejectedError, UnansweredError
from gateway.people.client.blocking import Client
from gateway.people.client.lease import Lease
from gateway.people.tools import kept_lease
from gateway.robot.core.calibration import Calibration, ServoCalibration, calibration_of
from schemas import calibration as wire
from schemas.telemetry import Ack


class ChangedMeanwhileError(GatewayError):
    """Another calibration is in force than the one that was to be changed."""

    def __init__(self, newer: Calibration) -> None:
        super().__init__(f"somebody else has changed the calibration meanwhile: revision {newer.revision} is in force")
        self.newer = newer


class NotKeptYetError(GatewayError):
    """The gateway is there, and has not answered a change: its disk takes long, or hangs."""


class Robot:
    """Acquires the lease before anything moves, and again once it was lost. For one thread at a time."""

    def __init__(self, client: Client, on_lost: Callable[[LeaseLostError], None]) -> None:
        """`on_lost` is called on a thread of its own."""
        self.client = client
        self._on_lost = on_lost
        self._lease: Lease | None = None
        self._held = ExitStack()

    def drive(self) -> None:
        """Hold the lease. `send` and `reset` of this user count meanwhile. Raises LeaseError, DisconnectedError."""
        if self._lease is not None and self._lease.held:
            return
        self.release()
        self._lease = self._held.enter_context(kept_lease.acquired(self.client, on_lost=self._on_lost))

    @property
    def drives(self) -> bool:
        """Whether we hold it."""
        return self._lease is not None and self._lease.held

    def release(self) -> None:
        """Let go of the lease."""
        self._held.close()

    def calibration(self) -> Calibration:
        """What is in force. Raises DisconnectedError, ValueError."""
        return calibration_of(self.client.calibration())

    def write(
        self, servos: Mapping[int, ServoCalibration], landing_cdeg: Mapping[int, int | None], revision: int
    ) -> Calibration:
        """Change these, if `revision` is in force; what is in force then.

        Raises ChangedMeanwhileError, RejectedError, NotKeptYetError, DisconnectedError.
        """
        self.drive()
        landing = {servo_id: None if cdeg is None else cdeg / 100 for servo_id, cdeg in landing_cdeg.items()}
        changes = {name: change_of(servo) for name, servo in servos.items()}
        ack = once_kept(self.client, lambda: self.client.calibrate(changes, landing, revision=revision))
        found = self.calibration()
        if ack.accepted:
            return found
        if found.revision != revision:
            raise ChangedMeanwhileError(found)
        raise RejectedError(str(ack.reason), ack.detail or "no reason was given")


def once_kept(client: Client, change: Callable[[], Ack]) -> Ack:
    """The answer to a change. Raises NotKeptYetError where only that is missing, and what `change` raises."""
    try:
        return change()
    except UnansweredError as error:
        client.state()  # raises where nobody answers at all
        raise NotKeptYetError(
            "the gateway runs, and its disk has not taken the change yet: look in some seconds whether it is in force "
            "(calibrate --show); if the disk hangs, trying again says so"
        ) from error


def change_of(servo: ServoCalibration) -> wire.ServoChange:
    """What is sent to make a servo's calibration this one."""
    return wire.ServoChange(**servo.report.model_dump())
