"""How commands reach the gateway: the failing step if nobody answers, and the lease.

Without an answer a program's `Client` raises at once. A command then ends, so it has time to find the cause.
"""

import getpass
import socket
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Final

from gateway.errors import RejectedError, UnansweredError, ZenohError
from gateway.host import effective
from gateway.host.directories import CONFIGURATION
from gateway.people.client.blocking import Client
from gateway.people.terminal import hint, say
from gateway.words.own_command import command
from schemas.ack import Ack
from schemas.keys import MAX_SOURCE
from schemas.words import Reason

Connection = Callable[[], AbstractContextManager[Client]]
_OTHERS_S: Final = 0.2
"""How long to wait for replies of other programs than the gateway."""


def me() -> str:
    """Return `user@host`, MAX_SOURCE characters at most: the driver's name without a certificate."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError, ImportError):  # a container's user without a name; Windows
        user = "somebody"
    name = f"{user}@{socket.gethostname()}"
    return name.encode(errors="replace").decode()[:MAX_SOURCE]  # bytes that are no UTF-8 are no JSON either


def connection(connect: str | None, zenoh_config: Path | None, timeout_s: float, *, source: str) -> Connection:
    """Return a connection to the given endpoint, or the file's, or this machine's gateway, for a `with`.

    If it or a question inside it fails, the ZenohError has a line for each endpoint, with the failing step.
    """

    @contextmanager
    def connected() -> Iterator[Client]:
        with Client(connect, zenoh_config=zenoh_config, source=source, timeout_s=timeout_s) as client:
            try:
                yield client
            except UnansweredError as error:
                from gateway.people.commands import why  # an emergency stop must not wait for this import

                raise ZenohError("\n".join(why.unanswered(client, connect, zenoh_config))) from error

    return connected


def show_differences(config: Path | None = None) -> None:
    """Print how the file differs from what this machine's service uses; nothing if none runs."""
    used = effective.running()
    for each in [] if used is None else effective.differences(used, config or CONFIGURATION):
        hint(each)


def rejected(error: RejectedError | Ack) -> int:
    """Print why a command was rejected, and what to do. Returns the exit code, 1."""
    say(f"rejected: {error.reason}: {error.detail}")
    if error.reason in (Reason.NOT_HOLDER, Reason.LEASE_HELD):
        hint(
            f"Wait until the lease is free (`{command('status --follow')}`), or request or take it in the console. "
            "Everybody may stop the robot."
        )
    elif error.reason == Reason.ESTOPPED:
        hint(until_reset())
    elif error.reason == Reason.NO_LEASE:
        hint(f"This robot obeys only the holder of the lease: `{command('send … --hold S')}` acquires it.")
    return 1


def warn_of_others(client: Client, key: str, say: Callable[[str], object]) -> None:
    """Call `say` with a warning if several programs answered the latest question on `key`."""
    if (count := len(client.answerers(key, _OTHERS_S))) > 1:
        say(
            f"{count} programs answer on {key}, and only one of them is the gateway; "
            "certificates keep others out (docs/certificates.md)"
        )


def until_reset() -> str:
    """Return what ends an emergency stop."""
    return f"All commands are rejected until `{command('reset')}`."
