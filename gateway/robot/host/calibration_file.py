"""The calibration on disk: TOML for people, written atomically, with ten earlier versions kept.

A damaged, truncated or foreign file is an error and not replaced by a default: with a wrong direction or trim, a servo
would move to an angle that was not commanded.
"""

import glob
import json
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Final

from pydantic import ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from gateway import durable, nesting
from gateway.errors import ConfigError
from gateway.host.directories import state_directory
from gateway.host.settings_reader import NO_SETTING, dotted
from gateway.model.calibration import RobotCalibration, calibration_of, report_of
from gateway.robot.settings import Settings
from gateway.text import echo
from schemas import calibration as wire
from schemas.robot import SERVO_IDS

CALIBRATION_FILE: Final = "calibration.toml"
"""File name in the service's state directory."""
CALIBRATION_VERSION: Final = 1
EARLIER_KEPT: Final = 10
MAX_CALIBRATION_BYTES: Final = 64 * 1024
"""A whole calibration takes 2 kB; a larger file is rejected unread."""

SLOW_S: Final = 5.0
"""A longer write counts as hanging and is reported. It takes milliseconds, on a worn card a second."""

MOST_DIGITS: Final = 18
"""The most digits of a revision. The gateway writes no longer ones, which would take long to parse."""

_HEAD: Final = """\
# How this robot's servos differ from the drawing (docs/robot.md). The gateway writes this file; restart it after
# a change by hand. On the wire a servo gets (180 - angle if inverted else angle) + trim_deg; min_deg, max_deg and the
# landing pose are angles as commands name them.
"""


def path_of(settings: Settings, find: Callable[[str], Path | None] = state_directory) -> Path | None:
    """Return the file in which the gateway keeps its calibration, or None for memory only.

    A reader that systemd need not have started finds its folder by `state_to_read`.
    """
    folder = find(settings.state.path)
    return None if folder is None else folder / CALIBRATION_FILE


def load(path: Path) -> tuple[RobotCalibration, str | None]:
    """Return the calibration at the start, and why no servo may be started with it (None: servos may).

    If the file cannot be used, this is the default calibration. Its revision is above those of all earlier files, so
    that the next one written is newer.
    """
    earlier: list[Path] = []
    with suppress(OSError):
        earlier = previous(path)
    newest = 1 + _number(path, earlier[0]) if earlier else 0
    try:
        found, fault = read(path), f"{path}: is missing, but {earlier[0].name} is in its folder" if earlier else None
    except ConfigError as error:
        found, fault = None, str(error)
    if found is None:
        return RobotCalibration(newest), fault
    return replace(found, revision=max(found.revision, newest)), None  # an earlier file may have been put back by hand


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
        path.parent.mkdir(parents=True, exist_ok=True)
        durable.write(path, to_toml(calibration).encode(), before=partial(_keep_previous, path))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); the old calibration stays") from error


def previous(path: Path) -> list[Path]:
    """Return the files of earlier calibrations in the same folder, newest first."""
    beside = path.parent.glob(f"{glob.escape(path.stem)}.*{glob.escape(path.suffix)}")
    numbered = [(number, found) for found in beside if (number := _number(path, found)) >= 0]
    return [found for _, found in sorted(numbered, reverse=True)]


def _number(path: Path, found: Path) -> int:
    """Return the revision in the name of an earlier calibration's file, or -1."""
    text = found.name[len(path.stem) + 1 : len(found.name) - len(path.suffix)]
    return int(text) if text.isascii() and text.isdecimal() and len(text) <= MOST_DIGITS else -1


def _keep_previous(path: Path) -> None:
    """Hard-link the current file under its revision. A complete file exists at any time."""
    try:
        before = read(path)
        name = None if before is None else str(before.revision)
    except ConfigError:
        name = "broken"
    if name is not None:
        copy = path.with_name(f"{path.stem}.{name}{path.suffix}")
        copy.unlink(missing_ok=True)
        os.link(path, copy)
        for old in previous(path)[EARLIER_KEPT:]:
            old.unlink()


# ---- as text


def to_toml(calibration: RobotCalibration) -> str:
    """Return the file's text. Its last line repeats the revision, which reveals a truncated file."""
    report = report_of(calibration)
    lines = [f"{_HEAD}version = {CALIBRATION_VERSION}", f"revision = {report.revision}", "", "[landing]"]
    lines += [f"{name} = {angle!r}" for name, angle in report.landing.items()]
    for name, servo in report.servos.items():
        lines += ["", f"[servos.{name}]", *(f"{each} = {json.dumps(value)}" for each, value in servo)]
    return "\n".join([*lines, "", "[end]", f"of_revision = {report.revision}", ""])


Degrees = Annotated[float, Field(ge=-360, le=360, allow_inf_nan=False)]


class _Servo(wire.ServoCalibration):
    model_config = ConfigDict(extra="forbid", strict=True)

    trim_deg: Degrees
    inverted: bool
    min_deg: Degrees
    max_deg: Degrees


class _File(wire.Calibration):
    model_config = ConfigDict(extra="forbid", strict=True)

    version: int
    revision: Annotated[int, Field(ge=0, lt=10**MOST_DIGITS)]
    landing: dict[str, Degrees]
    servos: dict[str, _Servo]  # type: ignore[assignment]  # nobody puts another kind into it
    end: dict[str, object]


_WHOLE: Final = "a whole calibration names every servo and all of its numbers"


def from_toml(data: bytes) -> RobotCalibration:
    """Return the calibration in a file's bytes. Raises ValueError with a sentence for the first fault."""
    values = nesting.read_toml(data)
    version = values.get("version")
    if version != CALIBRATION_VERSION:
        raise ValueError(f"version is {version!r}; this gateway reads {CALIBRATION_VERSION}")
    try:
        found = _File.model_validate(values)
    except ValidationError as error:
        raise ValueError(_fault(error.errors(include_url=False)[0])) from None
    if found.end != {"of_revision": found.revision}:
        raise ValueError(
            f"the last line is not of_revision = {found.revision}; the file was cut off, or half of it changed"
        )
    missing = [servo_id for servo_id in SERVO_IDS if str(servo_id) not in found.servos]
    if missing:
        raise ValueError(f"servos has no {missing[0]}; {_WHOLE}")
    return calibration_of(found)


def _fault(fault: ErrorDetails) -> str:
    place = dotted(fault["loc"])
    if fault["type"] == "missing":
        return f"{place}: is missing; {_WHOLE}"
    if fault["type"] == "extra_forbidden":
        return f"{place}: {NO_SETTING}"
    return f"{place}: {echo(fault['input'])} is not allowed: {fault['msg'][0].lower()}{fault['msg'][1:]}"
