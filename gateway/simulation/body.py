"""Zenoh access for the process that simulates the robot's body: a Unix socket, and its own keys only.

Only this user can enter the socket's folder, so the process needs no certificate. These rules are added only for a
simulated robot; no robot's Zenoh file has them.
"""

import secrets
from pathlib import Path
from typing import Any, Final

import zenoh

from gateway.certs import access
from gateway.errors import ConfigError
from gateway.zenoh.config import RETRY, get, insert, listen_endpoints, scouting_and_shared_memory_off

SUBJECT: Final = "the simulated body"
_LINK: Final = "unixsock-stream"
_CONTROL: Final = "access_control"
_USERS: Final = "transport/auth/usrpwd/dictionary_file"


def endpoint(folder: Path) -> str:
    """Return the gateway's endpoint for the simulation, a Unix socket in `folder`."""
    return f"{_LINK}/{folder / 'socket'}"


def admit(config: zenoh.Config, folder: Path) -> None:
    """Change `config` so that processes that can enter `folder` may publish the body.

    Raises ConfigError in Zenoh's client mode, or if Zenoh rejects a value.
    """
    if get(config, "mode") == "client":
        raise ConfigError('--sim=physics needs mode: "peer" in the Zenoh file: a client cannot be reached')
    insert(config, "listen/endpoints", [*listen_endpoints(config), endpoint(folder)], "zenoh.listen")
    if get(config, "transport/link/protocols"):
        _append(config, "transport/link/protocols", _LINK)
    if get(config, f"{_CONTROL}/enabled") is True:
        rules = [access.rule(each, get(config, "namespace") or "") for each in access.BODY]
        _append(config, f"{_CONTROL}/rules", *rules)
        _append(config, f"{_CONTROL}/subjects", {"id": SUBJECT, "link_protocols": [_LINK]})
        _append(config, f"{_CONTROL}/policies", {"subjects": [SUBJECT], "rules": [rule["id"] for rule in rules]})
    if (users := get(config, _USERS)) is not None:
        known = folder / "users"
        known.touch(0o600)
        known.write_text(f"{Path(users).read_text().rstrip()}\n{SUBJECT}:{secrets.token_hex()}\n")
        insert(config, _USERS, str(known), _USERS)


def client_config(gateway: zenoh.Config, folder: Path, zenoh_id: str) -> zenoh.Config:
    """Return the simulation's configuration, for a gateway that `admit` has configured. Raises ConfigError."""
    config = zenoh.Config()
    values = {
        "mode": "client",
        "id": zenoh_id,
        "connect/endpoints": [endpoint(folder)],
        "connect/timeout_ms": -1,
        "connect/retry": RETRY,
    }
    if namespace := get(gateway, "namespace"):
        values["namespace"] = namespace
    if users := get(gateway, _USERS):
        user, _, password = Path(users).read_text().splitlines()[-1].partition(":")
        values |= {"transport/auth/usrpwd/user": user, "transport/auth/usrpwd/password": password}
    for key, value in values.items():
        insert(config, key, value, key)
    scouting_and_shared_memory_off(config)
    return config


def _append(config: zenoh.Config, key: str, *values: Any) -> None:
    insert(config, key, [*(get(config, key) or []), *values], key)
