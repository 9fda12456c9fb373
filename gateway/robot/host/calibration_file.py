"""The calibration on disk: TOML for people, written atomically, with ten earlier versions kept.

A damaged, truncated or foreign file is an error and not replaced by a default: with a wrong direction or trim, a servo
would move to an angle that was not commanded.
"""

import json
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, get_args

from pydantic import ValidationError

from gateway import durable, nesting
from gateway.errors import ConfigError
from gateway.model.calibration import RobotCalibration, changed, report_of
from gateway.robot.core.rejections import explain
from schemas.calibration import CalibrationCommand, ServoChange, ServoName

CALIBRATION_FILE: Final = "calibration.toml"
"""File name in the service's state directory."""
CALIBRATION_VERSION: Final = 1
EARLIER_KEPT: Final = 10
MAX_CALIBRATION_BYTES: Final = 64 * 1024
"""A whole calibration takes 2 kB; a larger file is rejected unread."""

_HEAD: Final = """\
# How this robot's servos differ from the drawing (docs/robot.md). The gateway writes this file; restart it after
# a change by hand. On the wire a servo gets (180 - angle if inverted else angle) + trim_deg; min_deg, max_deg and the
# landing pose are angles as commands name them.
"""


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
