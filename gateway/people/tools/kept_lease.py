"""The lease of a person who drives from a shell: `lease acquire` holds it, `send` and `reset` carry its token.

It lies in a file that only its owner may read, in the folder that the system empties at logout (XDG_RUNTIME_DIR), and
is removed when the lease ends. It is never printed, and never an argument of a process, which all may read.
"""

import getpass
import hashlib
import json
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from gateway import durable
from gateway.errors import ConfigError, LeaseLostError
from gateway.people.client.blocking import Client
from gateway.people.client.lease import Lease

_FOLDER: Final = "hexapod-gateway"
_MAX_SOURCE: Final = 64


def me() -> str:
    """`user@host`, 64 characters at most: the driver's name where no certificate has one."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container's user without a name
        user = "somebody"
    return f"{user}@{socket.gethostname()}"[:_MAX_SOURCE]


def token_of(client: Client) -> str | None:
    """The token that this person keeps for the client's robot, if the gateway still takes it. Raises DisconnectedError.

    One that it no longer takes is forgotten: commands that carry it would be rejected.
    """
    token = _read(_file(client))
    if token is None:
        return None
    if client.lease_requests.renew(token).accepted:
        return token
    forget(client, token)
    return None


def _keep(file: Path, token: str) -> None:
    """Keep a token for the other commands of this person. Raises ConfigError."""
    try:
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        durable.write_with_mode(file, token.encode(), 0o600)
    except OSError as error:
        raise ConfigError(f"cannot keep the lease in {file}: {error.strerror}") from error


@contextmanager
def acquired(
    client: Client,
    *,
    take: bool = False,
    wait_s: float = 0.0,
    on_lost: Callable[[LeaseLostError], None] | None = None,
    on_asked: Callable[[str], None] | None = None,
) -> Iterator[Lease]:
    """Hold the lease, and keep its token meanwhile: `send` and `reset` of this person drive. See `Client.lease`."""
    lease = client.lease(take=take, wait_s=wait_s, source=me(), on_lost=on_lost, on_asked=on_asked)
    lease.acquire()
    token = lease.token or ""
    try:
        _keep(_file(client), token)
        yield lease
    finally:
        forget(client, token)
        lease.release()


def is_kept(client: Client, token: str) -> bool:
    """Whether the token is still kept; `lease release` forgets it."""
    return _read(_file(client)) == token


def forget(client: Client, token: str) -> None:
    """Delete the token, unless a newer one replaced it."""
    file = _file(client)
    if _read(file) == token:  # and not that of a newer one
        with suppress(OSError):
            file.unlink()


def _file(client: Client) -> Path:
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    above = Path(runtime) if runtime and Path(runtime).is_dir() else Path.home() / ".cache"
    return above / _FOLDER / f"lease-{hashlib.sha256(json.dumps(client.robot).encode()).hexdigest()[:16]}"


def _read(file: Path) -> str | None:
    try:
        return file.read_text("ascii").strip() or None
    except (OSError, ValueError):
        return None
