"""`walk` at a keyboard: who may drive, and what the program ends with."""

import importlib.util
import sys
from pathlib import Path

from gateway.errors import LeaseError
from gateway.people.tools import driving, kept_lease
from gateway.people.tools.reach import Connection
from gateway.people.tools.terminal import hint


def drive(connect: Connection, gait: str, geometry: Path | None, height_m: float | None) -> int:
    """Drive until q. Returns the exit code. Raises WalkError, ConfigError, ZenohError."""
    if importlib.util.find_spec("termios") is None:
        hint("walk from the keyboard needs a Unix terminal; on Windows, run it in WSL, or give --seconds.")
        return 1
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        hint("hexapod-gateway: walk from the keyboard needs a terminal; without one: --forward 0.1 --seconds 5")
        return 1
    from gateway.people.tools.walk.screen import Screen  # noqa: PLC0415 (does not load without termios)

    with connect() as client:
        try:
            with client.lease(source=kept_lease.me()) as lease:
                return Screen(client, lease.holder, gait, geometry, height_m).run()
        except LeaseError as error:
            return driving.not_acquired(client, error)
