"""The time since the boot, which nobody sets, and which boot that was: for what has to end in time across restarts."""

import os
import time
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple


class Now(NamedTuple):
    """The boot's id, the time since it, which nobody sets, and the wall clock."""

    boot: str = ""
    boot_s: float = 0.0
    wall_s: float = 0.0


def clocks() -> Now:
    """Return the present times. Outside Linux no boot has an id, and the wall clock counts as the time since it."""
    wall_s = time.time()
    has_boots = _boot() and hasattr(time, "CLOCK_BOOTTIME")
    return Now(_boot(), time.clock_gettime(time.CLOCK_BOOTTIME) if has_boots else wall_s, wall_s)


@cache
def _boot() -> str:
    """Return the boot's id, read once: later a flood may have taken the last descriptor. The unit passes it on."""
    with suppress(OSError):
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip().replace("-", "")
    return os.environ.get("BOOT_ID", "")
