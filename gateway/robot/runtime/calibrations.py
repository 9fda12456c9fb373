"""The calibration's two keys: publishes the calibration in force; decides, writes, then acknowledges a change.

Its file is TOML for people, written atomically, with ten earlier versions kept. A damaged, truncated or foreign file is
an error and not replaced by a default: with a wrong direction or trim, a servo would move to an angle that was not
commanded.
"""

import json
import logging
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, get_args

from pydantic import ValidationError

from gateway.errors import ConfigError
from gateway.files import durable, nesting
from gateway.model.calibration import RobotCalibration, changed, report_of
from gateway.robot.core.calibrating import UNTIL_TRUSTED
from gateway.robot.core.events import Calibrate, CalibrationSaved, SaveCalibration
from gateway.robot.core.message import Reply
from gateway.robot.core.rejections import explain, name_given_twice
from gateway.robot.host.disk import DiskWriter, StateFolder
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.runtime.request_answers import PAUSE_S, RequestAnswers
from gateway.robot.zenoh_io.receiver import OwnersTask
from gateway.words.own_command import command
from schemas import keys
from schemas.ack import Ack
from schemas.calibration import CalibrationCommand, ServoChange, ServoName
from schemas.words import Reason

CALIBRATION_FILE: Final = "calibration.toml"
"""File name in the service's state directory."""
CALIBRATION_VERSION: Final = 1
EARLIER_KEPT: Final = 10
HANDED_OVER: Final = "GATEWAY_HANDOVER_CALIBRATION"
"""The environment variable with a calibration in memory, for the program that this process executes next."""
MAX_CALIBRATION_BYTES: Final = 64 * 1024
"""A whole calibration takes 2 kB; a larger file is rejected unread."""

_HEAD: Final = """\
# How this robot's servos differ from the drawing (docs/robot.md). The gateway writes this file; restart it after
# a change by hand. On the wire a servo gets (180 - angle if inverted else angle) + trim_deg; min_deg, max_deg and the
# landing pose are angles as commands name them.
"""

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
        handed_over = os.environ.pop(HANDED_OVER, None)
        if folder is None and handed_over is not None:
            self._calibrating.load(from_toml(handed_over.encode()))
        if folder is not None:
            self._disk = DiskWriter("keep calibration", conductor.loop, conductor.owner)
            calibration, fault = load(folder.path / CALIBRATION_FILE)
            self._calibrating.load(calibration, fault)
            if fault is not None:
                logger.warning("%s; nothing is started %s: %s", fault, UNTIL_TRUSTED, command("calibrate"))

    def hand_over(self) -> dict[str, str]:
        """Return a calibration that no disk keeps as an environment variable. The caller owns the state."""
        return {} if self._folder is not None else {HANDED_OVER: to_toml(self._calibrating.in_force)}

    def publish(self) -> None:
        """Publish and record the calibration in force."""
        self._conductor.recorder.calibration(self._calibrating.in_force)
        self._conductor.reports.outbox.publish(keys.CALIBRATION, report_of(self._calibrating.in_force))

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
            return partial(self.reject, (source, source), unread, reply)
        event = Calibrate(change=change, key=self.key, sent_ms=change.sent_ms, lease=change.lease, reply=reply)
        event.source, event.source_id = change.source or source, source
        return partial(self.change, event)

    def change(self, event: Calibrate) -> None:
        """Let the supervisor decide. The answer follows the write, or the rejection."""
        conductor, now_ns = self._conductor, self._conductor.clock()
        too_old = conductor.too_old(event, now_ns, now_ns)
        if too_old is not None:
            conductor.executor.reject(event, Reason.STALE, too_old)
            return
        event.number = next(conductor.numbers)
        keep = conductor.ask(event).to_do
        if not isinstance(keep, SaveCalibration):
            return
        folder, kept = self._folder, partial(self._kept, keep.number)
        if folder is None:
            kept(None)
            return

        def keep_file() -> None:
            folder.own()
            write(folder.path / CALIBRATION_FILE, keep.calibration)

        self._disk.write(keep_file, kept)

    def _kept(self, number: int, fault: str | None) -> None:
        before = self._calibrating.in_force
        self._conductor.ask(CalibrationSaved(number, fault))
        if self._calibrating.in_force is not before:
            self.publish()
            self._conductor.reports.publish()


# ---- the file


def load(path: Path) -> tuple[RobotCalibration, str | None]:
    """Return the calibration at the start, and why no servo may be started with it (None: servos may).

    If the file cannot be used, this is the default calibration. Its revision is above those of all earlier files, so
    that the next one written is newer.
    """
    earlier: Mapping[int, Path] = {}
    with suppress(OSError):
        earlier = previous(path)
    newest = max(earlier, default=-1)
    fault = f"{path}: is missing, but {earlier[newest].name} is in its folder" if earlier else None
    try:
        found = read(path)
        if found is not None:  # one may have been put back by hand
            return replace(found, revision=max(found.revision, newest + 1)), None
    except ConfigError as error:
        fault = str(error)
    return RobotCalibration(newest + 1), fault


def read(path: Path) -> RobotCalibration | None:
    """Return the calibration in the file, or None if there is no file. Raises ConfigError if it cannot be used.

    This waits only for the disk: a FIFO at `path` is rejected without blocking.
    """
    try:
        data = durable.read(path, MAX_CALIBRATION_BYTES)
        return None if data is None else from_toml(data)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error


def write(path: Path, calibration: RobotCalibration) -> None:
    """Write atomically; it is on the disk when this returns. Raises ConfigError if that fails; the old file stays."""
    try:
        durable.write(path, to_toml(calibration).encode(), before=partial(_keep_previous, path))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); the old calibration stays") from error


def previous(path: Path) -> Mapping[int, Path]:
    """Return the files of earlier calibrations in the same folder by their revision, newest first. Raises OSError."""
    name = re.compile(rf"{re.escape(path.stem)}\.([0-9]+){re.escape(path.suffix)}")
    found = {int(match[1]): each for each in path.parent.iterdir() if (match := name.fullmatch(each.name))}
    return dict(sorted(found.items(), reverse=True))


def _keep_previous(path: Path) -> None:
    """Hard-link the current file under its revision. A complete file exists at any time."""
    name = "broken"
    with suppress(ConfigError):
        before = read(path)
        if before is None:
            return
        name = str(before.revision)
    copy = path.with_name(f"{path.stem}.{name}{path.suffix}")
    copy.unlink(missing_ok=True)
    os.link(path, copy)
    for old in list(previous(path).values())[EARLIER_KEPT:]:
        old.unlink()


def to_toml(calibration: RobotCalibration) -> str:
    """Return the file's text. Its last line repeats the revision, which reveals a truncated file."""
    report = report_of(calibration)
    lines = [f"{_HEAD}version = {CALIBRATION_VERSION}", f"revision = {report.revision}", "", "[landing]"]
    lines += [f"{name} = {angle!r}" for name, angle in report.landing.items()]
    for name, servo in report.servos.items():
        lines += ["", f"[servos.{name}]", *(f"{each} = {json.dumps(value)}" for each, value in servo)]
    return "\n".join([*lines, "", "[end]", f"of_revision = {report.revision}", ""])


def from_toml(data: bytes) -> RobotCalibration:
    """Return the calibration in a file's bytes. Raises ValueError with a sentence for the first fault."""
    values = nesting.read_toml(data)
    version, end, revision = values.pop("version", None), values.pop("end", None), values.get("revision")
    if version != CALIBRATION_VERSION:
        raise ValueError(f"version is {version!r}; this gateway reads {CALIBRATION_VERSION}")
    if end != {"of_revision": revision}:
        raise ValueError(f"the last line is not of_revision = {revision}; the file was cut off, or half of it changed")
    try:
        found = CalibrationCommand.model_validate(values)  # the file is a change of every value
    except ValidationError as error:
        raise ValueError(explain(error).detail) from None
    for name in get_args(ServoName):
        if len(found.servos.get(name, ServoChange()).model_fields_set) < len(ServoChange.model_fields):
            raise ValueError(f"servos.{name} is not whole; a whole calibration names every servo and all its numbers")
    return replace(changed(RobotCalibration(), found), revision=found.revision or 0)
