"""The calibration on disk: TOML that a person can read, written whole or not at all, with the ten before it.

A file that is broken, cut off or of another version is an error and not a default: with the wrong direction or trim a
servo would go where nobody sent it.
"""

import glob
import json
import os
import stat
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gateway import durable, nesting
from gateway.errors import ConfigError
from gateway.host.directories import SERVICE_STATE, state_directory
from gateway.model.calibration import Calibration, CalibrationError, ServoCalibration, report_of
from gateway.model.frames import centidegrees
from gateway.robot.settings import MISSING, Settings, dotted, faults_of
from schemas import calibration as wire
from schemas.robot import SERVO_IDS

NAME: Final = "calibration.toml"
"""In the service's state directory."""
VERSION: Final = 1
KEPT: Final = 10
"""How many earlier calibrations are kept beside the file."""
MAX_BYTES: Final = 64 * 1024
"""A whole calibration takes 2 kB; what is larger is no calibration, and is not read."""

SLOW_S: Final = 5.0
"""A write takes some milliseconds, on a worn card a second: one that takes longer hangs, and people are told."""

MOST_DIGITS: Final = 18
"""Of a revision: more is none of ours, and takes long to read."""

_HEAD: Final = """\
# How this robot's servos differ from the drawing (docs/calibration.md). The gateway writes this file; restart it after
# a change by hand. On the wire a servo gets (180 - angle if inverted else angle) + trim_deg; min_deg, max_deg and the
# landing pose are angles as commands name them.
"""


def path_of(settings: Settings) -> Path | None:
    """Where the gateway itself keeps its calibration; None: in memory only."""
    if settings.calibration.path:
        return Path(settings.calibration.path)
    folder = state_directory()
    return None if folder is None else folder / NAME


def path_to_read(settings: Settings) -> Path | None:
    """The same for whoever looks at it: also the service's, where systemd did not start the looker."""
    path = path_of(settings)
    return path if path is not None else SERVICE_STATE / NAME if SERVICE_STATE.is_dir() else None


def load(path: Path) -> tuple[Calibration, str | None]:
    """What a gateway starts with, and why nothing may be started with it, if so.

    Where the file cannot be used, that is the default with a revision which none of those beside the file has, so that
    what is kept next is newer than them.
    """
    earlier: list[Path] = []
    with suppress(OSError):
        earlier = previous(path)
    try:
        found = read(path)
    except ConfigError as error:
        fault = str(error)
    else:
        if found is not None:  # one of the earlier, put back by hand, is newer than all of them
            newest = 1 + _number(path, earlier[0]) if earlier else 0
            return replace(found, revision=max(found.revision, newest)), None
        if not earlier:
            return Calibration(), None
        fault = f"{path}: is missing, and {earlier[0].name} stands beside it"
    return Calibration(1 + _number(path, earlier[0]) if earlier else 0), fault


def read(path: Path) -> Calibration | None:
    """The calibration kept there; None: there is none yet. Raises ConfigError with one sentence.

    It waits for the disk, and for nothing else: not for somebody who writes into a pipe of that name.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with open(descriptor, "rb") as file:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise ConfigError(f"{path}: is no file")
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
    if len(data) > MAX_BYTES:
        raise ConfigError(f"{path}: is larger than {MAX_BYTES} bytes; that is no calibration")
    try:
        return from_toml(data)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error


def write(path: Path, calibration: Calibration) -> None:
    """Keep it: on disk when this returns, or the old one stays. Raises ConfigError. Takes as long as the disk does."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        durable.write(path, to_toml(calibration).encode(), before=partial(_keep_previous, path))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); the old calibration stays") from error


def previous(path: Path) -> list[Path]:
    """The earlier calibrations beside it, newest first."""
    beside = path.parent.glob(f"{glob.escape(path.stem)}.*{glob.escape(path.suffix)}")
    numbered = [(number, found) for found in beside if (number := _number(path, found)) >= 0]
    return [found for _, found in sorted(numbered, reverse=True)]


def _number(path: Path, found: Path) -> int:
    """The revision in an earlier calibration's name; -1: it has none."""
    text = found.name[len(path.stem) + 1 : len(found.name) - len(path.suffix)]
    return int(text) if text.isascii() and text.isdecimal() and len(text) <= MOST_DIGITS else -1


def _keep_previous(path: Path) -> None:
    """A second name for the file as it is; only then is it replaced, so that there is a whole one at any time."""
    try:
        before = read(path)
    except ConfigError:
        name = "broken"
    else:
        if before is None:
            return
        name = str(before.revision)
    copy = path.with_name(f"{path.stem}.{name}{path.suffix}")
    copy.unlink(missing_ok=True)
    os.link(path, copy)
    for old in previous(path)[KEPT:]:
        old.unlink()


# ---- as text


def to_toml(calibration: Calibration) -> str:
    """The file's text. Its last line names the revision again, so that a file that was cut off can be told."""
    report = report_of(calibration)
    lines = [f"{_HEAD}version = {VERSION}", f"revision = {report.revision}", "", "[landing]"]
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


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    version: int
    revision: Annotated[int, Field(ge=0, lt=10**MOST_DIGITS)]
    landing: dict[str, Degrees]
    servos: dict[str, _Servo]
    end: dict[str, object]


_WHOLE: Final = "a whole calibration names every servo and all of its numbers"


def from_toml(data: bytes) -> Calibration:
    """The calibration in a file. Raises ValueError with one sentence."""
    values = nesting.read_toml(data)
    version = values.get("version")
    if version != VERSION:
        raise ValueError(f"version is {version!r}; this gateway reads {VERSION}")
    try:
        found = _File.model_validate(values)
    except ValidationError as error:
        place, sentence = faults_of(error)[0]
        raise ValueError(f"{dotted(place)}: {sentence}{f'; {_WHOLE}' if sentence == MISSING else ''}") from None
    if found.end != {"of_revision": found.revision}:
        raise ValueError(
            f"the last line is not of_revision = {found.revision}; the file was cut off, or half of it changed"
        )
    missing = [servo_id for servo_id in SERVO_IDS if str(servo_id) not in found.servos]
    if missing:
        raise ValueError(f"servos has no {missing[0]}; {_WHOLE}")
    return Calibration(
        found.revision,
        {_servo_id(name): ServoCalibration.of_report(servo) for name, servo in found.servos.items()},
        {_servo_id(name): centidegrees(angle_deg) for name, angle_deg in found.landing.items()},
    )


def _servo_id(name: str) -> int:
    if name not in map(str, SERVO_IDS):
        raise CalibrationError(f"servo {name} does not exist; an id is the leg and the joint, such as 32")
    return int(name)
