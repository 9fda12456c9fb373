"""Who may do what at the running gateway: with certificates, without, and with the wrong ones.

Every way in which TLS turns somebody away is in test_diagnosis.py, as a person reads of it.
"""

import datetime as dt
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
import zenoh

from gateway import certs
from gateway.certs import authority
from gateway.client import leg_payload
from gateway.errors import ZenohError
from schemas import keys
from schemas.telemetry import Kind, Mode
from tests.support.gateway_process import Gateway, free_port
from tests.support.heard import events
from tests.support.secured import HOST, Secured

TLS, TIMEOUT = "transport/link/tls", "connect/timeout_ms"


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Secured]:
    folder = tmp_path_factory.mktemp("secured")
    with Secured(folder, {"telemetry": {"frames": True}}, address="0.0.0.0") as made:  # noqa: S104  (with mTLS)
        yield made


def test_an_observer_watches_and_commands_nothing(secured: Secured) -> None:
    """And takes no wildcard, below which it could declare 20 000 keys, each to be compared with all others."""
    wild: list[zenoh.Sample] = []
    with secured.client("anna") as anna, secured.client("otto") as otto, closing(secured.session("otto")) as session:
        declared = [session.declare_subscriber(key, wild.append) for key in ("hexapod/*", "hexapod/**", keys.RESET)]
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
        assert anna.reset().accepted
        assert list(session.get(keys.STATE)), "what came for it before has come"
        assert not wild
        del declared


def test_an_operator_cannot_pose_as_the_robot(secured: Secured) -> None:
    """Neither reports nor answers to others' commands pass; and it does not overhear them."""
    certs.folder.issue(secured.folder, "bert", "operator")
    overheard: list[zenoh.Sample | zenoh.Query] = []
    received: list[str] = []
    with secured.client("anna") as anna, secured.client("otto") as otto, closing(secured.session("bert")) as bert:
        heard = events(otto)
        declared = [
            *(bert.declare_subscriber(key, overheard.append) for key in (keys.leg_command(3), "hexapod/**/cmd")),
            *(bert.declare_queryable(key, overheard.append) for key in (keys.leg_command(3), keys.STATE)),
            *(otto.session.declare_subscriber(key, lambda each: received.append(each.payload.to_string()))
              for key in (keys.STATE, keys.EVENT, keys.FRAME)),
        ]  # fmt: skip
        otto.state()
        for key in (keys.STATE, keys.EVENT, keys.FRAME):
            bert.put(key, "forged")
        assert list(bert.liveliness().get(keys.ALIVE)), "on the same link, behind all that"
        for _ in range(3):
            assert anna.start_leg(3, 1, 2, 3).accepted
            assert not anna.set_leg(4, 1, 2, 3, check=False).accepted
            assert anna.state().mode == Mode.ACTIVE
        heard.wait(lambda event: event.kind is Kind.COMMAND_REJECTED, count=3)
        assert received
        assert "forged" not in received
        assert not overheard
        assert anna.stop().accepted
        del declared


def forged(secured: Secured, common_name: str, made: dt.datetime) -> zenoh.Config:
    """With a certificate of the folder's CA that `issue` would not make: any name, good for a day from `made`."""
    folder = secured.folder
    ca = certs.folder.load_ca(folder)
    pair = authority.make_leaf(ca, common_name, "someone", (), 1, made)
    (folder / "someone.pem").write_bytes(pair.certificate_pem())
    (folder / "someone.key").write_bytes(pair.key_pem())
    shown = {"certificate": str(folder / "someone.pem"), "private_key": str(folder / "someone.key")}
    return secured.raw("anna", **{f"{TLS}/connect_{name}": path for name, path in shown.items()})


@pytest.mark.parametrize("role", ["stranger", "gateway", "operator", "Operator-40", "operator-*", "operator-40"])
def test_a_certificate_without_a_role_commands_nothing(secured: Secured, role: str) -> None:
    """It takes one of our own CA: the session opens, and that is all. An operator's messages arrive."""
    may = role == "operator-40"
    with secured.client("anna") as anna, closing(zenoh.open(forged(secured, role, dt.datetime.now(dt.UTC)))) as session:
        before = anna.state().estop
        timeout_s = 20 if may else 1
        asked = [session.get(keys.STATE, timeout=timeout_s), session.get(keys.ESTOP, timeout=timeout_s)]
        asked += [session.liveliness().get(keys.ALIVE, timeout=timeout_s)]
        assert [len(list(replies)) for replies in asked] == [may] * 3
        session.put(keys.ESTOP, b"")
        session.close()  # all that it sent has been read by then
        assert (anna.state().estop > before) is may
        assert anna.reset().accepted


def test_a_link_ends_when_its_certificate_expires(secured: Secured) -> None:
    made = dt.datetime.now(dt.UTC) - dt.timedelta(days=1, seconds=-5)
    with closing(zenoh.open(forged(secured, "operator-41", made))) as session:
        assert list(session.get(keys.STATE))
        give_up_s = time.monotonic() + 60
        while session.info.links():
            assert time.monotonic() < give_up_s
            time.sleep(0.01)
        assert not list(session.get(keys.STATE, timeout=1))


def test_without_a_certificate_of_its_ca_nobody_comes_in(secured: Secured, tmp_path: Path) -> None:
    certs.folder.init(tmp_path / "E", [HOST])
    certs.folder.issue(tmp_path / "E", "eve", "operator")
    eve = str(tmp_path / "E" / "eve")
    for certificate, key in ((None, None), (f"{eve}.pem", f"{eve}.key")):
        shown = {f"{TLS}/connect_certificate": certificate, f"{TLS}/connect_private_key": key}
        with pytest.raises(zenoh.ZError, match="Unable to connect"):
            zenoh.open(
                secured.raw("anna", **{f"{TLS}/enable_mtls": certificate is not None}, **shown, **{TIMEOUT: 1000})
            )


def test_off_loopback_it_does_not_start(tmp_path: Path) -> None:
    with Gateway(tmp_path, {"zenoh": {"listen": [f"tcp/0.0.0.0:{free_port()}"]}}, wait=False) as gateway:
        assert gateway.child.wait() == 2
        (line,) = gateway.child.stderr.splitlines()
        assert "would let anyone on the network move the robot" in line
