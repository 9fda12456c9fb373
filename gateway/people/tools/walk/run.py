"""`walk` at a keyboard: who may drive, and what the program ends with."""

from pathlib import Path

from gateway.errors import LeaseError
from gateway.people.terminal import hint, why_no_screen
from gateway.people.tools import driving, kept_lease
from gateway.people.tools.reach import Connection


def drive(connect: Connection, gait: str, geometry: Path | None, height_m: float | None) -> int:
    """Drive until q. Returns the exit code. Raises WalkError, ConfigError, ZenohError."""
    why_not = why_no_screen(
        "walk from the keyboard", "; without one: --forward 0.1 --seconds 5", on_windows=", or give --seconds"
    )
    if why_not is not None:
        hint(f"hexapod-gateway: {why_not}")
        return 1
    from gateway.people.tools.walk.screen import Screen  # noqa: PLC0415 (does not load without termios)

    with connect() as client:
        try:
            with client.lease(source=kept_lease.me()) as lease:
                return Screen(client, lease.holder, gait, geometry, height_m).run()
        except LeaseError as error:
            return driving.not_acquired(client, error)
