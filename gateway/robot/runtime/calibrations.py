"""The calibration's two keys: publishes the calibration in force; decides, writes, then acknowledges a change."""

import logging
from functools import partial

from pydantic import ValidationError

from gateway.model.calibration import RobotCalibration, report_of
from gateway.own_command import command
from gateway.robot.core.calibrating import ACCEPT_DEFAULT
from gateway.robot.core.events import Calibrate, CalibrationSaved, SaveCalibration
from gateway.robot.core.message import Reply
from gateway.robot.core.rejections import explain, name_given_twice
from gateway.robot.host import calibration_file
from gateway.robot.host.calibration_file import CALIBRATION_FILE
from gateway.robot.host.disk import DiskWriter, StateFolder
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.runtime.request_answers import PAUSE_S, RequestAnswers
from gateway.robot.zenoh_io.receiver import OwnersTask
from schemas import keys
from schemas.calibration import CalibrationCommand
from schemas.telemetry import Ack, Reason

logger = logging.getLogger(__name__)


class Calibrations(RequestAnswers):
    """Answers requests for a change, and publishes the calibration in force."""

    key = keys.CALIBRATION_CMD
    ack = Ack
    pause_s = PAUSE_S

    def __init__(self, conductor: Conductor, folder: StateFolder | None) -> None:
        """Load the calibration from `folder`. None: changes last until the process ends.

        Without a usable file no servo can be started, but the service runs: Stops need no calibration.
        """
        super().__init__(conductor)
        self._calibrating = conductor.supervisor.calibrating
        self._folder = folder
        if folder is not None:
            self._disk = DiskWriter("keep calibration", conductor.loop, conductor.owner)
            calibration, fault = calibration_file.load(folder.path / CALIBRATION_FILE)
            self._calibrating.load(calibration, fault)
            if fault is not None:
                logger.warning("%s; nothing is started until `%s`", fault, command(ACCEPT_DEFAULT))

    def publish(self) -> None:
        """Publish and record the calibration in force."""
        self._conductor.recorder.calibration(self._calibrating.in_force)
        self._conductor.events.outbox.publish(keys.CALIBRATION, report_of(self._calibrating.in_force))

    def answer(self, reply: Reply) -> None:
        """Answer a `get` with the calibration in force."""
        reply(report_of(self._calibrating.in_force).model_dump_json().encode())

    def read(self, payload: bytes, _now_ns: int, reply: Reply, source: str | None = None, /) -> OwnersTask:
        try:
            change = CalibrationCommand.model_validate_json(payload)
            unread = name_given_twice(payload)
        except ValidationError as error:
            unread = explain(error)
        if unread is not None:
            return partial(self.reject, source, unread.reason, unread.detail, reply)
        return partial(self.change, change, change.source or source, reply)

    def change(self, change: CalibrationCommand, source: str | None, reply: Reply) -> None:
        """Let the supervisor decide. The answer follows the write, or the rejection."""
        conductor, executor = self._conductor, self._conductor.executor
        now_ns = conductor.clock()
        event = Calibrate(
            change=change, key=self.key, source=source, sent_ms=change.sent_ms, lease=change.lease, reply=reply
        )
        too_old = conductor.too_old(event, now_ns, now_ns)
        if too_old is not None:
            executor.reject(event, Reason.STALE, too_old)
            return
        event.number = next(conductor.numbers)
        keep = conductor.ask(event).to_do
        if not isinstance(keep, SaveCalibration):
            return
        kept = partial(self._kept, keep.number)
        if self._folder is None:
            kept(None)
        else:
            self._disk.write(partial(_write, self._folder, keep.calibration), kept)

    def _kept(self, number: int, fault: str | None) -> None:
        before = self._calibrating.in_force
        self._conductor.ask(CalibrationSaved(number, fault))
        if self._calibrating.in_force is not before:
            self.publish()
            self._conductor.reports.publish()


def _write(folder: StateFolder, calibration: RobotCalibration) -> None:
    folder.own()
    calibration_file.write(folder.path / CALIBRATION_FILE, calibration)
