"""Who may do what at the running gateway: with certificates, without, and with the wrong ones.

Every way in which TLS turns somebody away is in test_diagnosis.py, as a person reads of it.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from gateway import certs
from gateway.client import leg_payload
from gateway.errors import ZenohError
from schemas import keys
from schemas.telemetry import Kind, Mode
from tests.support.gateway_process import Gateway, free_port
from tests.support.heard import events
from tests.support.secured import HOST, Secured

TLS = "transport/link/tls"


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Secured]:
    folder = tmp_path_factory.mktemp("secured")
    with Secured(folder, {"telemetry": {"frames": True}}, address="0.0.0.0") as made:  # noqa: S104  (with mTLS)
        yield made


def test_an_observer_watches_and_commands_nothing(secured: Secured) -> None:
    with secured.client("anna") as anna, secured.client("otto") as otto:
        heard = events(otto)
        before = otto.state().commands
        with pytest.raises(ZenohError, match="may you command it"):
            otto.start_leg(3, 1, 2, 3)
        otto.publish(keys.leg_command(3), leg_payload("start", (1, 2, 3)))
        otto.session.put(keys.ESTOP, b"")
        otto.session.delete(keys.leg_command(3))
        # On the same link, after all that: what the observer may do arrives, so the others had their chance.
        state = otto.state()
        assert state.mode == Mode.IDLE
        assert (state.commands.accepted, state.commands.rejected) == (before.accepted, before.rejected)
        anna.set_leg(3, 1, 2, 3, check=False)
        assert heard.wait(lambda event: event.kind is Kind.COMMAND_REJECTED).source == "anna"


def turned_away(config: zenoh.Config) -> None:
    config.insert_json5("connect/timeout_ms", "1000")
    with pytest.raises(zenoh.ZError, match="Unable to connect"):
        zenoh.open(config)


def test_without_a_certificate_of_its_ca_nobody_comes_in(secured: Secured, tmp_path: Path) -> None:
    certs.folder.init(tmp_path / "E", [HOST])
    certs.folder.issue(tmp_path / "E", "eve", "operator")
    eve = str(tmp_path / "E" / "eve")
    for certificate, key in ((None, None), (f"{eve}.pem", f"{eve}.key")):
        shown = {f"{TLS}/connect_certificate": certificate, f"{TLS}/connect_private_key": key}
        turned_away(secured.raw("anna", **{f"{TLS}/enable_mtls": certificate is not None}, **shown))


def test_off_loopback_it_does_not_start(tmp_path: Path) -> None:
    with Gateway(tmp_path, {"zenoh": {"listen": [f"tcp/0.0.0.0:{free_port()}"]}}, wait=False) as gateway:
        assert gateway.child.wait() == 2
        (line,) = gateway.child.stderr.splitlines()
        assert "would let anyone on the network move the robot" in line


def test_a_password_is_enough(tmp_path: Path) -> None:
    (tmp_path / "users.txt").write_text("anna:secret\n")
    (tmp_path / "zenoh.json5").write_text('{ transport: { auth: { usrpwd: { dictionary_file: "users.txt" } } } }')
    port = free_port()
    zenoh_settings = {"config": str(tmp_path / "zenoh.json5"), "listen": [f"tcp/0.0.0.0:{port}"]}
    with Gateway(tmp_path, {"zenoh": zenoh_settings}):
        turned_away(_client_config(port))
        anna = {"transport/auth/usrpwd/user": "anna", "transport/auth/usrpwd/password": "secret"}
        turned_away(_client_config(port, **{**anna, "transport/auth/usrpwd/password": "guess"}))
        with zenoh.open(_client_config(port, **anna)) as session:
            (reply,) = session.get(keys.STATE, timeout=10)
            assert reply.ok is not None


def _client_config(port: int, **settings: Any) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    for key, value in {"connect/endpoints": [f"tcp/{HOST}:{port}"], **settings}.items():
        config.insert_json5(key, json.dumps(value))
    return config
