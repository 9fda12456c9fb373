"""Find why the gateway is not reached or does not answer, after a failed command and for `check`."""

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from gateway import certs
from gateway.errors import ConfigError, DisconnectedError, UnansweredError, ZenohError
from gateway.people.client import diagnosis
from gateway.people.client.blocking import Client
from gateway.people.client.diagnosis import Finding, Stage
from gateway.people.client.lease_requests import Identity
from gateway.zenoh.config import client_config
from schemas import keys

_ANSWER_S: Final = 0.5
_SOON_S: Final = 0.3
_PAUSE_S: Final = 0.01
_ISSUE: Final = "hexapod-gateway certs issue NAME --role operator --dir DIR"


def unreached(connect: str | None, zenoh_config: Path | None) -> list[str]:
    """Return why each endpoint is not reached, a line each, after 1 s at most."""
    try:
        return diagnosis.why(client_config(connect, zenoh_config))
    except ConfigError as error:  # such as an expired certificate
        return str(error).splitlines()


def unanswered(client: Client | None, connect: str | None, zenoh_config: Path | None) -> list[str]:
    """Return why no answer comes, a line each. `client`: None if no session could be opened."""
    if client is None or not client.session.info.links():
        return unreached(connect, zenoh_config)
    try:
        identity = Identity.of(client_config(connect, zenoh_config))
    except ConfigError as error:
        return str(error).splitlines()
    return [f"no gateway answered: {allowed(client, identity)[-1]}"]


def allowed(client: Client, identity: Identity) -> list[Finding]:
    """Return the findings about role and gateway, after 1 s at most."""
    role = ""
    with suppress(ConfigError):  # the file cannot be read
        role = "" if identity.certificate is None else certs.folder.describe(identity.certificate).role
    try:
        state = client.state(_ANSWER_S)
    except ZenohError as error:
        if isinstance(error, DisconnectedError) and not isinstance(error, UnansweredError):
            sentence, _, fix = str(error).partition("; ")
            return [Finding(Stage.GATEWAY, sentence, fix)]
        return [_nobody(client, role)]
    by = f", as {role}" if role else ""
    if _may_command(client):
        commands = Finding(Stage.ROLE, f"you may command{by}")
        return [commands, Finding(Stage.GATEWAY, f"answers, and is {state.mode}")]
    sentence = f"you may not command, as {role or 'nobody in particular'}"
    watches = Finding(Stage.ROLE, f"you may watch{by}")
    return [watches, Finding(Stage.ROLE, sentence, f"ask the robot's owner for a certificate: {_ISSUE}")]


def _nobody(client: Client, role: str) -> Finding:
    """Return the finding about an open connection on which no gateway answers."""

    def links() -> set[str]:
        return {link.src for link in client.session.info.links()}

    first = links()
    if role and role.partition(".")[0] not in certs.LAPTOP_ROLES:
        sentence = f"the connection is open, but your certificate is of {role}, which is no role"
        return Finding(Stage.ROLE, sentence, f"get a laptop's from the robot's owner: {_ISSUE}")
    # As after a revocation. Zenoh, which retries each second, may have opened another.
    if role and _soon(lambda: not links() or links() != first):
        return Finding(
            Stage.ROLE,
            "the connection was open, and the robot ended it: your certificate is revoked, or its places are taken",
            "where ca.key is, hexapod-gateway certs list --dir DIR shows whether it is revoked; "
            f"{_ISSUE} makes another. Copy its files here",
        )
    fix = "does it run behind this router, and with this namespace? Its journal: journalctl -u hexapod-gateway"
    return Finding(Stage.GATEWAY, "the connection is open, but no gateway answers there", fix)


def _may_command(client: Client) -> bool:
    """Whether the gateway takes this session's commands, by matching alone: access control hides its keys."""
    with client.session.declare_publisher(keys.LEGS_COMMAND) as publisher:
        matches: Any = publisher  # Zenoh's type stub takes the status for a bool
        return _soon(lambda: bool(matches.matching_status.matching))


def _soon(condition: Callable[[], bool]) -> bool:
    """Return whether the condition holds within 0.3 s."""
    end_s = time.monotonic() + _SOON_S
    while not (holds := condition()) and time.monotonic() < end_s:
        time.sleep(_PAUSE_S)
    return holds
