"""The calibration's two keys: publishes the calibration in force; decides, writes, then acknowledges a change."""

import asyncio
import logging
from collections.abc import Callable
from functools import partial
from typing import Final

from gateway.model.calibration import RobotCalibration, report_of
from gateway.robot.core import calibration_intake
from gateway.robot.core.events import Calibrate, CalibrationSaved
from gateway.robot.core.message import Reply
from gateway.robot.core.rejections import Rejection
from gateway.robot.host.calibration_file import SLOW_S
from gateway.robot.host.ownership import OwnersTimer
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.runtime.request_answers import PAUSE_S, RequestAnswers
from gateway.robot.zenoh_io.receiver import OwnersTask
from schemas import keys
from schemas.calibration import CalibrationCommand
from schemas.telemetry import Ack, Reason

WriteAndThen = Callable[[RobotCalibration, Callable[[str | None], None]], None]
"""Returns at once. Calls back as owner of the state: None if the calibration is on the disk, else the fault."""

HANGS: Final = (
    f"the disk has not answered for {SLOW_S:g} s; if it stays silent, restart the gateway, and read the "
    "calibration in force"
)

logger = logging.getLogger(__name__)


class Calibrations(RequestAnswers):
    """Answers requests for a change, and publishes the calibration in force."""

    key = keys.CALIBRATION_CMD
    ack = Ack
    pause_s = PAUSE_S

    # mutants accepted (Forget): it is written anew
    def __init__(self, conductor: Conductor, keep: WriteAndThen | None, loop: asyncio.AbstractEventLoop) -> None:
        """`keep` writes a calibration to the disk. None: changes last until the process ends."""
        super().__init__(conductor)
        self._slow = OwnersTimer(loop, conductor.owner, self._note_delay)
        self._keep = keep
        self._written = b""
        self._written_of: RobotCalibration | None = None

    def announce_start(self) -> None:  # mutants accepted (Is_IsNot): a line in the log
        """Publish the calibration at the start. Log if it is kept in memory only."""
        if self._keep is None:
            logger.info("the calibration is kept in memory only, until this process ends (state.path)")
        self.publish()

    def publish(self) -> None:
        """Publish and record the calibration in force."""
        self._conductor.recorder.calibration(self._in_force)
        self._conductor.events.outbox.publish(keys.CALIBRATION, report_of(self._in_force))

    def answer(self, reply: Reply) -> None:  # mutants accepted (Forget): it is written anew
        """Answer a `get` with the calibration in force."""
        if self._written_of is not self._in_force:  # cached, since clients may ask at any rate
            self._written_of = self._in_force
            self._written = report_of(self._in_force).model_dump_json().encode()
        reply(self._written)

    def read(self, payload: bytes, _now_ns: int, reply: Reply, source: str | None = None, /) -> OwnersTask:
        command = calibration_intake.read(payload)
        if isinstance(command, Rejection):
            return partial(self.reject, source, command.reason, command.detail, reply)
        return partial(self.change, command, command.source or source, reply)

    def change(self, command: CalibrationCommand, source: str | None, reply: Reply) -> None:
        """Let the supervisor decide. The answer follows the write, or the rejection."""
        conductor, executor = self._conductor, self._conductor.executor
        now_ns = conductor.record_alive()
        event = Calibrate(
            change=command, revision=command.revision, accept_default=command.accept_default is not None,
            key=self.key, source=source, sent_ms=command.sent_ms, lease=command.lease, reply=reply,
        )  # fmt: skip
        too_old = conductor.too_old(event, now_ns, now_ns)
        if too_old is not None:
            executor.reject(event, Reason.STALE, too_old)
            return
        event.number = executor.next_number()
        keep = conductor.ask(event).keep
        if keep is None:
            return
        kept = partial(self._kept, keep.number)
        if self._keep is None:
            kept(None)
        else:
            self._slow.set_in(SLOW_S)
            self._keep(keep.calibration, kept)

    def _note_delay(self) -> None:
        """Report a slow write. No other change is accepted until its result is known."""
        self._conductor.supervisor.calibrating.note_delay(HANGS)
        logger.warning("a change of the calibration is not kept yet: %s; running servos continue", HANGS)

    def _kept(self, number: int, fault: str | None) -> None:
        self._slow.cancel()
        before = self._in_force
        self._conductor.ask(CalibrationSaved(number, fault))
        if self._in_force is not before:
            self.publish()
            self._conductor.reports.publish()

    @property
    def _in_force(self) -> RobotCalibration:
        return self._conductor.supervisor.calibrating.in_force
