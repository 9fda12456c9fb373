"""Making a recording whole that was cut off (its writer was killed, or its computer lost its power) or is damaged."""

import os
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from gateway import durable
from gateway.errors import ConfigError
from gateway.people.recordings.pieces import MAGIC, Losses, opened
from gateway.people.recordings.reading import records
from gateway.people.recordings.writing import Copy, in_use


class Repaired(NamedTuple):
    """What a repair found: how many messages, how many seconds from the first to the last, and what was lost."""

    messages: int
    seconds: float
    losses: Losses
    original: Path | None
    """Where the file is kept as it was, if there may be more in it than could be read."""


def is_cut_off(path: Path) -> bool:
    """Whether this is the beginning of an MCAP file without its end, which nobody is writing. False if unreadable."""
    with suppress(OSError), opened(path) as file:
        if file.read(len(MAGIC)) != MAGIC or in_use(file.fileno()):
            return False
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - len(MAGIC)))
        return size < 2 * len(MAGIC) or file.read() != MAGIC
    return False


def is_damaged(path: Path) -> bool:
    """Whether a part of this file cannot be read, and nobody is writing it. Reads all of it. Raises ConfigError."""
    losses = Losses()
    for _ in records(path, losses):
        pass
    with opened(path) as file:
        return bool(losses.places) and not in_use(file.fileno())


def repair(path: Path) -> Repaired:
    """Put a whole file in the place of one that was cut off or is damaged, with all that can be read of it.

    One of which more than its unfinished end could not be read is kept beside it, as `.damaged`. Raises ConfigError
    where there is nothing to be read, OSError where the disk does not take it; the file is then as it was.
    """
    losses = Losses()
    with durable.replacing(path) as staged:
        with staged.open("wb") as file:
            count, seconds = _copy(path, losses, Copy(file))
        durable.sync(staged)
        original = _kept_beside(path) if losses else None
    return Repaired(count, seconds, losses, original)


def _kept_beside(path: Path) -> Path:
    """Give the file a second name, which nobody else's file has. Raises OSError."""
    number = 1
    while True:
        beside = path.with_name(f"{path.name}.damaged{'' if number == 1 else f'-{number}'}")
        try:
            beside.hardlink_to(path)
        except FileExistsError:
            number += 1
        except OSError:  # a memory card's file system has no second names
            if os.path.lexists(beside):
                number += 1
                continue
            path.rename(beside)
            return beside
        else:
            return beside


def _copy(path: Path, losses: Losses, copy: Copy) -> tuple[int, float]:
    """How many messages were copied, and the seconds from the first to the last."""
    count, first_ns, last_ns = 0, 0, 0
    for message in copy.messages(records(path, losses)):
        copy.add(message, message.log_time, message.sequence)
        first_ns = message.log_time if count == 0 else min(first_ns, message.log_time)
        last_ns = max(last_ns, message.log_time)
        count += 1
    if count == 0:
        if losses:
            raise ConfigError(f"{path}: no message in it can be read; it is left as it is")
        raise ConfigError(f"{path}: was cut off before its first message; there is nothing in it, and it can go")
    copy.finish()
    return count, (last_ns - first_ns) / 1e9
