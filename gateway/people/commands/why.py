"""Find why the gateway is not reached or does not answer, after a failed command and for `check`."""

import time
from pathlib import Path
from typing import Any, Final

from gateway.certs import LAPTOP_ROLES
from gateway.errors import ConfigError, DisconnectedError, UnansweredError, ZenohError
from gateway.people.client import diagnosis
from gateway.people.client.blocking import Client
from gateway.people.client.diagnosis import Finding, Stage
from gateway.people.client.requests import Identity
from gateway.zenoh_config import client_config
from schemas import keys

_DIAGNOSIS_S: Final = 1.0
"""How long a failed command may look for the reason."""
_ANSWER_S: Final = 0.5
_MATCHING_S: Final = 0.3
_PAUSE_S: Final = 0.01


def unreached(connect: str | None, zenoh_config: Path | None) -> list[str]:
    """Return why each endpoint is not reached, a line each, after 1 s at most."""
    try:
        return diagnosis.why(client_config(connect, zenoh_config), _DIAGNOSIS_S)
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
    role = "" if identity.certificate is None else diagnosis.role(identity.certificate)
    try:
        state = client.state(_ANSWER_S)
    except ZenohError as error:
        if isinstance(error, DisconnectedError) and not isinstance(error, UnansweredError):
            sentence, _, fix = str(error).partition("; ")
            return [Finding(Stage.GATEWAY, sentence, fix)]
        return [_nobody(role, ended=_ended(client))]
    watching = Finding(Stage.ROLE, "you may watch" + (f", as {role}" if role else ""))
    if not _may_command(client):
        fix = "ask the robot's owner for a certificate: hexapod-gateway certs issue NAME --role operator --dir DIR"
        return [watching, Finding(Stage.ROLE, f"you may not command, as {role or 'nobody in particular'}", fix)]
    commanding = Finding(Stage.ROLE, "you may command" + (f", as {role}" if role else ""))
    return [commanding, Finding(Stage.GATEWAY, f"answers, and is {state.mode}")]


def _ended(client: Client) -> bool:
    """Return whether the connection has ended, also if Zenoh, which retries each second, has opened another."""
    first, end_s = _links(client), time.monotonic() + _MATCHING_S
    while (now := _links(client)) == first != set() and time.monotonic() < end_s:
        time.sleep(_PAUSE_S)
    return now != first or not now


def _links(client: Client) -> set[str]:
    return {link.src for link in client.session.info.links()}


def _nobody(role: str, *, ended: bool) -> Finding:
    """`ended`: the open connection has ended, as after a revocation."""
    if role and role.partition(".")[0] not in LAPTOP_ROLES:
        fix = "get a laptop's from the robot's owner: hexapod-gateway certs issue NAME --role operator --dir DIR"
        return Finding(Stage.ROLE, f"the connection is open, but your certificate is of {role}, which is no role", fix)
    if role and ended:
        sentence = (
            "the connection was open, and the robot ended it: your certificate is revoked, or its places are taken"
        )
        fix = (
            "where ca.key is, hexapod-gateway certs list --dir DIR shows whether it is revoked; "
            "hexapod-gateway certs issue NAME --role operator --dir DIR makes another. Copy its files here"
        )
        return Finding(Stage.ROLE, sentence, fix)
    fix = "does it run behind this router, and with this namespace? Its journal: journalctl -u hexapod-gateway"
    return Finding(Stage.GATEWAY, "the connection is open, but no gateway answers there", fix)


def _may_command(client: Client) -> bool:
    """Whether the gateway takes this session's commands, by matching alone: access control hides its keys."""
    with client.session.declare_publisher(keys.LEGS_COMMAND) as publisher:
        status: Any = publisher.matching_status  # Zenoh's type stub takes it for a bool
        end_s = time.monotonic() + _MATCHING_S
        while not status.matching and time.monotonic() <= end_s:
            time.sleep(_PAUSE_S)
            status = publisher.matching_status
    return bool(status.matching)
