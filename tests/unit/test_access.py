"""Who may say what, read from the file that `certs init` writes: the whole table, and nothing beside it.

What Zenoh makes of it is tests/zenoh/test_security.py's; here every message, direction, key and role is tried.
"""

import json
from pathlib import Path
from typing import Any

import pytest
import zenoh

from gateway.certs.access import endpoint, gateway_json5, laptop_json5
from gateway.errors import ConfigError
from gateway.simulation import body as simulated_body
from schemas.keys import (
    ALIVE,
    BUTTON,
    CALIBRATION,
    COMMAND_KEYS,
    CONFIG,
    ESTOP,
    EVENT,
    FRAME,
    GET_ONLY,
    SIM_BODY,
    SIM_UPRIGHT,
    STATE,
)

DECLARATIONS = ("declare_subscriber", "declare_queryable", "declare_liveliness_subscriber")
MESSAGES = ("put", "delete", "query", "reply", "liveliness_token", "liveliness_query", *DECLARATIONS)
FLOWS = ("ingress", "egress")
TELEMETRY = (STATE, CONFIG, EVENT, FRAME, CALIBRATION, SIM_BODY)
OTHERS = ("hexapod/secret", "hexapod/*", "hexapod/**", "**", "robot2/hexapod/state", "robot2/hexapod/estop/cmd")
KEYS = (*COMMAND_KEYS, *GET_ONLY, "hexapod/leg/*/cmd", "hexapod/**/cmd", *TELEMETRY, ALIVE, SIM_UPRIGHT, *OTHERS)
WILD = ("hexapod/leg/*/cmd", "hexapod/**/cmd")

Said = tuple[str, str, str]
"""Flow, message, key."""


def config(text: bytes, folder: Path) -> zenoh.Config:
    assert b"@" not in text, "each name in the template has its value"
    (folder / "zenoh.json5").write_bytes(text)
    return zenoh.Config.from_file(str(folder / "zenoh.json5"))


def get(made: zenoh.Config, key: str) -> Any:
    return json.loads(made.get_json(key))


@pytest.fixture
def gateway(tmp_path: Path) -> zenoh.Config:
    return config(gateway_json5(["robot.local"], 7447), tmp_path)


def allowed(made: zenoh.Config, role: str) -> set[Said]:
    """Return all messages that a client with this common name may send or receive, by Zenoh's documented rules."""
    control = get(made, "access_control")
    assert (control["enabled"], control["default_permission"]) == (True, "deny")
    subjects = {each["id"] for each in control["subjects"] if role in (each.get("cert_common_names") or [each["id"]])}
    named = {name for policy in control["policies"] if subjects & set(policy["subjects"]) for name in policy["rules"]}
    rules = [rule for rule in control["rules"] if rule["id"] in named]
    assert named == {rule["id"] for rule in rules}
    assert {rule["permission"] for rule in control["rules"]} == {"allow"}
    return {
        (flow, message, key)
        for flow in FLOWS
        for message in MESSAGES
        for key in KEYS
        if any(
            flow in rule["flows"]
            and message in rule["messages"]
            and any(zenoh.KeyExpr(each).includes(zenoh.KeyExpr(key)) for each in rule["key_exprs"])
            for rule in rules
        )
    }


def said(flow: str, messages: str, *keys: str) -> set[Said]:
    return {(flow, message, key) for message in messages.split() for key in keys}


# Nobody declares a wildcard: each declaration that is let in is compared with all others.
WATCHING = (
    said("ingress", "declare_subscriber", *TELEMETRY)
    | said("egress", "put", *TELEMETRY)
    | said("ingress", "query", STATE, CONFIG, CALIBRATION)
    | said("egress", "reply declare_queryable", STATE, CONFIG, CALIBRATION)
    | said("ingress", "declare_liveliness_subscriber liveliness_query", ALIVE)
    | said("egress", "liveliness_token", ALIVE)
)
COMMANDING = (
    said("ingress", "put delete query", *COMMAND_KEYS, *GET_ONLY, *WILD)
    | said("egress", "reply declare_subscriber declare_queryable", *COMMAND_KEYS, *GET_ONLY, *WILD)
    | said("ingress", "query", SIM_UPRIGHT)
    | said("egress", "reply declare_queryable", SIM_UPRIGHT)
)
LYING = (
    said("ingress", "put", SIM_BODY)
    | said("egress", "declare_subscriber", SIM_BODY)
    | said("ingress", "declare_subscriber query", CALIBRATION)
    | said("egress", "put reply declare_queryable", CALIBRATION)
    | said("ingress", "declare_queryable reply", SIM_UPRIGHT)
    | said("egress", "query", SIM_UPRIGHT)
)
"""What a simulated body may."""
PRESSING = (
    said("ingress", "put query", ESTOP)
    | said("egress", "reply declare_subscriber declare_queryable", ESTOP)
    | said("ingress", "query", BUTTON)
    | said("egress", "reply declare_queryable", BUTTON)
)


@pytest.mark.parametrize(
    ("role", "expected"),
    [("operator", WATCHING | COMMANDING), ("observer", WATCHING), ("button", WATCHING | PRESSING), ("somebody", set())],
)
def test_each_role_may_do_this_and_nothing_else(gateway: zenoh.Config, role: str, expected: set[Said]) -> None:
    assert allowed(gateway, role) == expected


def test_a_simulated_body_comes_in_by_its_socket_and_changes_nothing_for_people(
    tmp_path: Path, gateway: zenoh.Config
) -> None:
    made, roles = gateway, ("operator", "observer", "button")
    before = {role: allowed(made, role) for role in roles}
    simulated_body.admit(made, tmp_path)
    assert allowed(made, simulated_body.SUBJECT) == LYING
    assert {role: allowed(made, role) for role in before} == before
    (subject,) = (each for each in get(made, "access_control/subjects") if each["id"] == simulated_body.SUBJECT)
    assert {name: value for name, value in subject.items() if value} == {
        "id": simulated_body.SUBJECT,
        "link_protocols": ["unixsock-stream"],
    }
    assert get(made, "listen/endpoints") == ["tls/[::]:7447", f"unixsock-stream/{tmp_path}/socket"]
    assert get(made, "transport/link/protocols") == ["tls", "unixsock-stream"]


def test_a_simulated_body_needs_a_gateway_that_listens(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match='--sim=physics needs mode: "peer" in the Zenoh file'):
        simulated_body.admit(config(b'{ mode: "client" }', tmp_path), tmp_path)


FILES: dict[str, bytes] = {
    "gateway": gateway_json5(["robot.local"], 7447),
    "laptop": laptop_json5(
        "anna", "operator", [endpoint("robot.local", 7447), endpoint("fd00::1", 7447)], "anna.json5"
    ),
}
FOR_ALL: dict[str, object] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/shared_memory/enabled": False,
    "transport/link/protocols": ["tls"],
    "transport/link/tx/lease": 1000,
    "transport/link/rx/max_message_size": 65536,
    "transport/link/tls/root_ca_certificate": "ca.pem",
    "transport/link/tls/enable_mtls": True,
    "transport/link/tls/verify_name_on_connect": True,
}
ITS_OWN: dict[str, dict[str, object]] = {
    "gateway": {
        "mode": "peer",
        "listen/endpoints": ["tls/[::]:7447"],
        "transport/link/tls/listen_certificate": "gateway.pem",
        "transport/link/tls/listen_private_key": "gateway.key",
        "adminspace/enabled": False,
        "transport/link/tls/close_link_on_expiration": True,
    },
    "laptop": {
        "mode": "client",
        "connect/endpoints": ["tls/robot.local:7447", "tls/[fd00::1]:7447"],
        "transport/unicast/open_timeout": 1000,
        "transport/link/tls/connect_certificate": "anna.pem",
        "transport/link/tls/connect_private_key": "anna.key",
    },
}


@pytest.mark.parametrize("name", FILES)
def test_each_roles_file_states_who_comes_in_and_how_much(tmp_path: Path, name: str) -> None:
    made = config(FILES[name], tmp_path)
    wanted = FOR_ALL | ITS_OWN[name]
    assert {key: get(made, key) for key in wanted} == wanted


def test_far_too_large_messages_are_dropped_before_they_reach_the_gateway(gateway: zenoh.Config) -> None:
    (limit,) = get(gateway, "low_pass_filter")
    assert limit["flows"] == ["ingress"]
    assert set(limit["messages"]) == {"put", "delete", "query", "reply"}
    assert limit["key_exprs"] == ["**"]
    assert limit["size_limit"] == 16_384
