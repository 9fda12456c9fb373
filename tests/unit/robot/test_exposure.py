"""Which configurations let a stranger command the robot: rejected, unless somebody says that it is meant."""

import json
from pathlib import Path
from typing import Any

import pytest
import zenoh

from gateway.errors import ConfigError
from gateway.host.settings_table import ZenohSettings
from gateway.robot.zenoh_io import exposure
from gateway.robot.zenoh_io.session import service_config
from gateway.zenoh.config import listen_endpoints
from gateway.zenoh.endpoints import is_local
from tests.support.gateway_process import dialling

MTLS = {"transport/link/tls/enable_mtls": True, "transport/link/tls/root_ca_certificate": "/ca.pem"}


def config(**settings: Any) -> zenoh.Config:
    made = zenoh.Config()
    for key, value in {"mode": "peer", **settings}.items():
        made.insert_json5(key, json.dumps(value))
    return made


def rejected(*listen: str, **settings: Any) -> bool:
    """Check that it is rejected; `settings` may have the endpoints, too."""
    try:
        exposure.check(config(**{"listen/endpoints": list(listen), **settings}), allow_insecure=False)
    except ConfigError:
        return True
    return False


@pytest.mark.parametrize(
    ("listen", "settings", "expected"),
    [
        (["tls/0.0.0.0:7447"], MTLS, False),
        (["tls/0.0.0.0:7447", "tcp/127.0.0.1:7448"], MTLS, False),
        (["tls/0.0.0.0:7447"], {**MTLS, "transport/link/tls/enable_mtls": False}, True),
        (["tls/0.0.0.0:7447#enable_mtls=false"], MTLS, True),
        (["tls/0.0.0.0:7447#root_ca_certificate_file=/mine.pem"], MTLS, True),
    ],
)
def test_tls_with_client_certificates(listen: list[str], settings: dict[str, Any], expected: bool) -> None:
    assert rejected(*listen, **settings) is expected


CONTROLLED = {**MTLS, "access_control/enabled": True, "access_control/default_permission": "deny"}


@pytest.mark.parametrize("settings", [MTLS, {"access_control/enabled": True}, CONTROLLED])
@pytest.mark.parametrize(
    ("endpoint", "why"),
    [
        ("tls/127.0.0.1:7447", None),
        ("tcp/127.0.0.1:7447", None),  # without a certificate access control lets nothing through
        ("udp/127.0.0.1:7447", None),
        ("unixsock-stream//run/gateway.sock", None),
        ("quic/127.0.0.1:7447", "over QUIC, revoked clients cannot be disconnected"),
        ("quic_datagram/127.0.0.1:7447", "over QUIC, revoked clients cannot be disconnected"),
        *(
            (endpoint, "would let anyone on the network")
            for endpoint in (
                "tcp/0.0.0.0:7447",
                "tcp/[::ffff:192.0.2.7]:7447",
                "tcp/192.0.2.7:7447#iface=lo",
                "tcp/localhost.example.com:7447",
                "udp/0.0.0.0:7447",
                "serial//dev/ttyUSB0",
                "carrier-pigeon/127.0.0.1:1",
            )
        ),
    ],
)
def test_each_kind_of_link_with_certificates(settings: dict[str, Any], endpoint: str, why: str | None) -> None:
    assert is_local(endpoint) is (why is None) or "QUIC" in str(why)
    checked = config(**{"listen/endpoints": [endpoint], **settings})
    if why is None:
        exposure.check(checked, allow_insecure=False)
    else:
        with pytest.raises(ConfigError, match=why):
            exposure.check(checked, allow_insecure=False)


@pytest.mark.parametrize("dialled", [False, True])
def test_no_option_brings_quic_together_with_certificates(dialled: bool) -> None:
    where: dict[str, list[str]] = {"listen/endpoints": [], "connect/endpoints": []}
    where["connect/endpoints" if dialled else "listen/endpoints"] = ["quic/192.0.2.1:7447"]
    with pytest.raises(ConfigError, match="write tls/ in place of quic/"):
        exposure.check(config(**where, **MTLS), allow_insecure=True)
    exposure.check(config(**where), allow_insecure=True)


@pytest.mark.parametrize(
    ("text", "endpoint", "expected"),
    [
        *(
            ("anna:secret\n", endpoint, False)
            for endpoint in ("tcp/0.0.0.0:7447", "tcp/robot:7447", "udp/0.0.0.0:7447")
        ),
        *(("anna:secret\n", endpoint, True) for endpoint in ("udp/224.0.0.224:7446", "udp/group:7446")),  # multicast
        *((text, "tcp/0.0.0.0:7447", True) for text in ("", "\n\n", "anna\n", ":secret\n", "anna:\n")),
    ],
)
def test_passwords_and_that_an_empty_dictionary_is_none(
    tmp_path: Path, text: str, endpoint: str, expected: bool
) -> None:
    users = tmp_path / "users.txt"
    users.write_text(text)
    assert rejected(endpoint, **{"transport/auth/usrpwd/dictionary_file": str(users)}) is expected


@pytest.mark.parametrize("content", [None, b"anna:\xff"], ids=["missing", "no text"])
def test_a_password_file_that_cannot_be_read_is_named(tmp_path: Path, content: bytes | None) -> None:
    users = tmp_path / "users.txt"
    if content is not None:
        users.write_bytes(content)
    settings = {"listen/endpoints": ["tcp/0.0.0.0:7447"], "transport/auth/usrpwd/dictionary_file": str(users)}
    with pytest.raises(ConfigError, match=r"users\.txt: the password file cannot be read"):
        exposure.check(config(**settings), allow_insecure=True)


def test_endpoints_by_mode() -> None:
    by_mode = {"listen/endpoints": {"peer": ["tcp/127.0.0.1:1"], "router": ["tcp/0.0.0.0:1"]}}
    assert (rejected(**by_mode), rejected(**by_mode, mode="router")) == (False, True)


def test_listening_nowhere_and_dialling_nobody_is_a_mistake(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nobody could reach the gateway"):
        service_config(ZenohSettings(listen=()))
    service_config(ZenohSettings(listen=(), config=dialling(tmp_path, "tcp/127.0.0.1:7447")))


def test_what_makes_one_wonder_is_said(caplog: pytest.LogCaptureFixture) -> None:
    rule = {"id": "r", "permission": "deny", "flows": ["ingress"], "messages": ["put"], "key_exprs": ["**"]}
    odd = {"listen/endpoints": [], "connect/endpoints": ["tcp/192.0.2.1:7447"], "access_control": {"rules": [rule]}}
    exposure.check(config(**odd), allow_insecure=False)
    assert "192.0.2.1:7447 is dialled without TLS" in caplog.text
    assert "access_control has rules, but is not enabled" in caplog.text


NAME_UNCHECKED = {"transport/link/tls/verify_name_on_connect": False}


@pytest.mark.parametrize(
    ("endpoint", "settings", "expected"),
    [
        ("tcp/192.0.2.1:7447", {}, True),
        ("tcp/127.0.0.1:7447", {}, False),
        ("tls/192.0.2.1:7447", MTLS, False),
        ("quic/192.0.2.1:7447", {}, False),
        ("tls/192.0.2.1:7447", {**MTLS, **NAME_UNCHECKED}, True),
        ("tls/192.0.2.1:7447#verify_name_on_connect=false", MTLS, True),
    ],
)
def test_a_link_without_certificates_that_is_dialled_is_named(
    caplog: pytest.LogCaptureFixture, endpoint: str, settings: dict[str, Any], expected: bool
) -> None:
    exposure.check(
        config(**{"listen/endpoints": [], "connect/endpoints": [endpoint], **settings}), allow_insecure=False
    )
    assert ("is dialled without TLS" in caplog.text) is expected
    assert "access_control" not in caplog.text


def test_defaults_listen_on_this_machine_only() -> None:
    assert listen_endpoints(service_config(ZenohSettings())) == ["tcp/127.0.0.1:7447"]


@pytest.mark.parametrize(
    ("stated", "warns"),
    [
        ({"scouting": {"multicast": {"enabled": True}}}, True),
        ({"scouting": {"gossip": {"enabled": True}}}, True),
        ({"scouting": {"multicast": {"enabled": True}}, "transport": {"link": {"protocols": ["tls"]}}}, False),
        ({}, False),
    ],
)
def test_scouting_is_what_the_zenoh_file_says(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, stated: dict[str, Any], warns: bool
) -> None:
    path = tmp_path / "zenoh.json5"
    path.write_text(json.dumps(stated))
    made = service_config(ZenohSettings(listen=("unixsock-stream//run/x",), config=str(path), allow_insecure=True))
    for way in ("multicast", "gossip"):
        assert json.loads(made.get_json(f"scouting/{way}/enabled")) is (way in stated.get("scouting", {}))
    assert ("dials every Zenoh program" in caplog.text) is warns


def test_rules_without_the_robots_namespace_are_rejected() -> None:
    """Nobody could command that robot, nor stop it."""

    def with_rules(*keys: str, enabled: bool = True, **more: Any) -> bool:
        rule = {"id": "in", "permission": "allow", "flows": ["ingress"], "messages": ["put"], "key_exprs": list(keys)}
        control = {"enabled": enabled, "default_permission": "deny", "rules": [rule], "subjects": [], "policies": []}
        return rejected("tcp/127.0.0.1:7447", **{"access_control": control, "namespace": "robot-1", **more})

    assert with_rules("hexapod/estop/cmd")
    assert with_rules("robot-10/hexapod/estop/cmd")
    assert not with_rules("**/hexapod/estop/cmd")
    assert not with_rules("hexapod/estop/cmd", namespace=None)
    assert not with_rules("robot-1/hexapod/estop/cmd", "@/router/**"), "one key of its own is enough"
    assert not with_rules("hexapod/estop/cmd", enabled=False), "Zenoh ignores them"
