"""The command's three uses: serve the page, make a link for another browser, end all sessions."""

import importlib.util
import socket
from contextlib import suppress
from pathlib import Path
from typing import Final, NoReturn
from urllib.parse import urlsplit

from gateway.errors import ConfigError, UnreachedError
from gateway.people.console import sessions
from gateway.people.console.messages import ROLES
from gateway.people.console.sessions import Register
from gateway.people.console.site import DEFAULT_ADDRESS, DEFAULT_PORT, address_of, free_address, site
from gateway.people.console.sockets import address_in, inherited
from gateway.people.terminal import hint, say

NEEDS: Final = ("websockets", "segno")
LOOK_S: Final = 1.0
CALIBRATION: Final = "cal"
"""The card of the page that is the guide through the calibration."""


def console(
    *,
    listen: str | None,
    connect: str | None,
    zenoh_config: Path | None,
    timeout_s: float,
    cert: Path | None,
    key: Path | None,
    role: str,
    geometry: Path | None,
    open_browser: bool,
    card: str = "",
) -> NoReturn:
    """Serve the page until the process is asked to end. Raises GatewayError.

    On systemd's socket; without one at `listen`; without both on a free port.
    """
    _need_extra()
    if role not in ROLES:
        raise ConfigError(
            f"--role {role}: pages are an operator's (drive, stop), a button's (only stop) or an observer's (only look)"
        )
    from gateway.people.console.serve import Options, serve  # noqa: PLC0415 (does not load without them)

    passed = inherited()
    address = address_in(passed, listen) if passed else listen or free_address()
    serve(
        Options(
            site=site(address, cert, key),
            passed=passed,
            listen_given=bool(passed or listen),
            connect=connect,
            zenoh_config=zenoh_config,
            timeout_s=timeout_s,
            role=role,
            geometry=geometry,
            open_browser=open_browser,
            card=card,
        )
    )


def calibration(connect: str | None, zenoh_config: Path | None, timeout_s: float) -> int:
    """Lead to the guide: in this user's console, or in one that is started for this gateway. Raises GatewayError."""
    if connect is None and zenoh_config is None and _answering() is not None:
        return link(None, CALIBRATION)
    hint("A console starts for the guide; Ctrl-C ends it.")
    console(
        listen=None,
        connect=connect,
        zenoh_config=zenoh_config,
        timeout_s=timeout_s,
        cert=None,
        key=None,
        role="operator",
        geometry=None,
        open_browser=True,
        card=CALIBRATION,
    )


def link(listen: str | None, card: str = "") -> int:
    """Print a link into the console that runs at that address, for another browser. Raises GatewayError.

    Without an address: into the console of this user, or for root the service's, that answers, wherever it listens.
    """
    _need_extra()
    from gateway.people.console.serve import show  # noqa: PLC0415 (the same)

    address, port = (_answering() or (DEFAULT_ADDRESS, DEFAULT_PORT)) if listen is None else address_of(listen)
    made = Register(register.folder(), port).new_link(card)
    try:
        socket.create_connection((address, port), LOOK_S).close()
    except OSError as error:
        raise UnreachedError(
            f"no console answers at {listen or f'{address}:{port}'}: {error.strerror or error}; start it, and ask again"
        ) from error
    show(made)
    return 0


def _answering() -> tuple[str, int] | None:
    for port, url in register.begun(register.folder()):
        for address in (DEFAULT_ADDRESS, urlsplit(url).hostname):
            with suppress(OSError):
                socket.create_connection((address, port), LOOK_S).close()
                return address or DEFAULT_ADDRESS, port
    return None


def revoke() -> int:
    """End all sessions of this user's consoles, or as root of the service's. Raises GatewayError."""
    ended = register.revoke_all(register.folder())
    say(f"{ended} session{'' if ended == 1 else 's'} ended; no link that was printed works any more")
    return 0


def _need_extra() -> None:
    missing = [name for name in NEEDS if importlib.util.find_spec(name) is None]
    if missing:
        raise ConfigError(f"the console needs {', '.join(missing)}: pip install 'hexapod-gateway[console]'")
