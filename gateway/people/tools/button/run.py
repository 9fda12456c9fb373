"""`button`: whether this terminal can be one, and what the program ends with."""

from gateway.errors import RejectedError
from gateway.people.terminal import hint, visible, why_no_screen
from gateway.people.tools import kept_lease
from gateway.people.tools.reach import Connection


def called(name: str | None) -> str:
    """By which name, where no certificate says it."""
    return name or kept_lease.me()


def hold(connect: Connection, name: str | None) -> int:
    """Be a button until Ctrl-C. Returns the exit code. Raises ConfigError, ZenohError."""
    why_not = why_no_screen("button", "", on_windows=", or open the console's /button")
    if why_not is not None:
        hint(f"hexapod-gateway: {why_not}")
        return 1
    from gateway.people.tools.button.screen import Screen  # noqa: PLC0415 (does not load without termios)

    with connect() as client:
        try:
            button = client.button(called(name))
            button.register()
        except RejectedError as error:
            hint(f"hexapod-gateway: {visible(str(error))}")
            return 1
        return Screen(client, button).run()
