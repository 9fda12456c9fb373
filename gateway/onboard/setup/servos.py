"""Whether a servo runs, as the service writes it ten times a second into its runtime directory."""

import time
from pathlib import Path
from typing import Final

FILE: Final = "/run/hexapod-gateway/servos"
_OLD_NS: Final = 1_000_000_000
_PAUSE_S: Final = 0.1
_TIMES: Final = 20


def any_runs(path: Path) -> bool | None:
    """None: the service hangs, has just begun, or is of a release that writes no such file."""
    for _ in range(_TIMES):
        try:
            written_ns, running = map(int, path.read_text().split())
        except (OSError, ValueError):
            return None
        if time.monotonic_ns() - written_ns < _OLD_NS:
            return bool(running)
        time.sleep(_PAUSE_S)
    return None
