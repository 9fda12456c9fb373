"""The command's three uses: serve the page, print a link for another browser, end all sessions."""

import importlib.util
import socket
from contextlib import suppress
from typing import Final, NoReturn
from urllib.parse import urlsplit

from gateway.errors import ConfigError, UnreachedError
from gateway.host.directories import console_state
from gateway.people.commands.options import Reach
from gateway.people.console import ConsoleOptions
from gateway.people.console.server import site
from gateway.people.console.server.sessions import Sessions, kept
from gateway.people.terminal import hint, say
from gateway.words.own_command import install

NEEDS: Final = ("aiohttp", "segno")
ANSWERS_S: Final = 1.0
"""How long a console that runs may take to accept a connection."""
CALIBRATION_CARD: Final = "cal"


def console(options: ConsoleOptions, card: str = "") -> NoReturn:
    """Serve the page until the process is asked to end. Raises GatewayError.

    On systemd's socket; without one at `listen`; without both on a free port. The first link leads to `card`.
    """
    _need_extra()
    from gateway.people.console import phone  # noqa: PLC0415 (does not load without them)
    from gateway.people.console.serve import serve  # noqa: PLC0415 (likewise)

    passed = site.inherited()
    if options.phone:
        options = phone.prepared(options, console_state())
    address = site.address_in(passed, options.listen) if passed else options.listen or site.free_address()
    place = site.site(address, options.cert, options.key, options.host or ())
    if not passed and options.listen is None and place.port != site.CONSOLE_PORT:
        hint(f"Port {site.CONSOLE_PORT} is taken by another program, so the console listens on {place.port}.")
    serve(options, place, passed, card)


def calibration(reach: Reach) -> int:
    """Open the calibration guide, in this user's console or in one started for this gateway. Raises GatewayError."""
    if reach.connect is None and reach.zenoh_config is None and _answering() is not None:
        return link(None, CALIBRATION_CARD)
    hint("A console starts for the guide; Ctrl-C ends it.")
    console(ConsoleOptions(reach=reach, open_browser=True), CALIBRATION_CARD)


def link(listen: str | None, card: str = "") -> int:
    """Print a link to the console that runs at this address, for another browser. Raises GatewayError.

    Without an address: to this user's console (root: the service's) that answers, wherever it listens.
    """
    _need_extra()
    from gateway.people.console.serve import show  # noqa: PLC0415 (likewise)

    address, port = (
        (_answering() or (site.DEFAULT_ADDRESS, site.CONSOLE_PORT)) if listen is None else site.address_of(listen)
    )
    made = Sessions(console_state(), port).new_link(card)
    try:
        socket.create_connection((address, port), ANSWERS_S).close()
    except OSError as error:
        raise UnreachedError(
            f"no console answers at {listen or f'{address}:{port}'}: {error.strerror or error}; start it, and ask again"
        ) from error
    show(made)
    return 0


def _answering() -> tuple[str, int] | None:
    for each in kept(console_state()):
        for address in (site.DEFAULT_ADDRESS, urlsplit(each.before_token).hostname) if each.before_token else ():
            with suppress(OSError):
                socket.create_connection((address, each.port), ANSWERS_S).close()
                return address or site.DEFAULT_ADDRESS, each.port
    return None


def sign_out() -> int:
    """End all sessions of this user's consoles (root: the service's). Raises GatewayError."""
    ended = sum(each.revoke() for each in kept(console_state()))
    say(f"{ended} session{'' if ended == 1 else 's'} ended; no printed link works any more")
    return 0


def _need_extra() -> None:
    missing = [name for name in NEEDS if importlib.util.find_spec(name) is None]
    if missing:
        raise ConfigError(f"the console needs {', '.join(missing)}: {install('console')}")
