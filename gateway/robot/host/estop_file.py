"""The emergency stop on disk, for the next run.

`estop.json` exists while an emergency stop is engaged. `estop-last.json` has the number of the latest one that was
left. Numbers continue, so that a reset for an earlier run names no emergency stop of this one.
"""

import os
import secrets
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Final, NamedTuple, TypeVar

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from gateway import durable
from gateway.errors import ConfigError

ESTOP_FILE: Final = "estop.json"
LAST_FILE: Final = "estop-last.json"
MAX_BYTES: Final = 4096
"""A file has about 200; a larger one is rejected unread."""
MAX_NUMBER: Final = 2**53
"""The largest exact integer in JavaScript."""
_UNHEARD_OF: Final = 10**9
"""If the last number is not known, numbers continue a random step above this, so that no earlier reset names them."""


class KeptEstop(NamedTuple):
    number: int
    """Its number; 0: there was none."""
    engaged: bool = False
    source: str | None = None
    time: datetime | None = None
    fault: str | None = None
    """Why it is not known, and so counts as engaged."""


class _Last(BaseModel):
    model_config = ConfigDict(extra="forbid")

    number: Annotated[int, Field(ge=0, lt=MAX_NUMBER, strict=True)]


class _Engaged(_Last):
    source: str | None
    time: AwareDatetime


Model = TypeVar("Model", bound=_Last)


def read(folder: Path) -> KeptEstop:
    """Return the emergency stop that an earlier run left in `folder`. Waits for the disk. Never raises.

    It counts as engaged if the files cannot be read, or the folder cannot be written: an earlier run may have failed to
    keep it.
    """
    last = 0
    try:
        os.listdir(folder)  # raises for a missing folder, whose missing files mean nothing
        last = _number(folder)
        engaged = _content(folder / ESTOP_FILE, _Engaged)
        if engaged is not None:
            return KeptEstop(max(engaged.number, last), True, engaged.source, engaged.time)
        found = KeptEstop(last)
        write(folder, found)
    except OSError as error:
        return unknown(f"{error.filename or folder}: {error.strerror or error}", last)
    except ConfigError as error:
        return unknown(str(error), last)
    return found


def unknown(fault: str, last: int = 0) -> KeptEstop:
    """Return an emergency stop that counts as engaged, with a number that no reset can name yet."""
    number = last + _UNHEARD_OF + secrets.randbelow(_UNHEARD_OF)
    return KeptEstop(number, True, time=datetime.now(UTC), fault=fault)


def write(folder: Path, kept: KeptEstop) -> None:
    """Write atomically; it is on the disk when this returns. Raises ConfigError if it cannot be written."""
    try:
        if kept.engaged:
            source = None if kept.source is None else kept.source.encode(errors="replace").decode()
            engaged = _Engaged(number=kept.number, source=source, time=kept.time or datetime.now(UTC))
            _write_engaged(folder / ESTOP_FILE, engaged.model_dump_json().encode())
        else:  # the number first: after a crash between the two, the emergency stop is engaged
            durable.write(folder / LAST_FILE, _Last(number=kept.number).model_dump_json().encode())
            (folder / ESTOP_FILE).unlink(missing_ok=True)
            durable.sync(folder)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written ({error.strerror or error})") from error


def _write_engaged(path: Path, data: bytes) -> None:
    """Write the file. A new file exists before its sync, so a gateway killed meanwhile leaves it.

    A power cut may leave a part of it, and a damaged file counts as engaged.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    except FileExistsError:
        durable.write(path, data)
        return
    with open(descriptor, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(descriptor)
    durable.sync(path.parent)


def _number(folder: Path) -> int:
    """Return the number of the latest emergency stop that was left. Raises OSError."""
    try:
        found = _content(folder / LAST_FILE, _Last)
    except ConfigError:  # a damaged number alone engages nothing
        return unknown("").number
    return 0 if found is None else found.number


def _content(path: Path, model: type[Model]) -> Model | None:
    """Return the file's content, or None without a file. Raises OSError, or ConfigError if it is damaged."""
    try:
        data = durable.read(path, MAX_BYTES)
        return None if data is None else model.model_validate_json(data)
    except ValidationError as error:
        raise ConfigError(f"{path}: is damaged ({error.errors()[0]['msg']})") from error
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error
