"""Who may do what at the running gateway: with certificates, without, and with the wrong ones.

And every way in which a laptop does not reach the robot: one line names the step.
"""

import datetime as dt
import shutil
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Final

import pytest
import zenoh

from gateway import certs
from gateway.certs import authority
from gateway.client import Client
from gateway.errors import DisconnectedError, ZenohError
from gateway.people.client.payloads import leg_payload
from schemas import keys
from schemas.words import Kind, Mode
from tests.support.command import Ended, run_here
from tests.support.gateway_process import HOST, Gateway, Secured, free_port
from tests.support.heard import events
from tests.support.waiting import wait_until

TLS, TIMEOUT = "transport/link/tls", "connect/timeout_ms"


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Secured]:
    folder = tmp_path_factory.mktemp("secured")
    with Secured(folder, {"telemetry": {"frames": True}}, address="0.0.0.0") as made:  # noqa: S104  (with mTLS)
        yield made


def test_an_observer_watches_and_commands_nothing(secured: Secured) -> None:
    """It may not declare a wildcard: it could declare 20 000 keys below, and each would be compared with all others."""
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
    """Return a certificate of the folder's CA that `issue` would not make: any name, good for a day from `made`."""
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


def test_a_client_whose_certificate_has_expired_says_so(secured: Secured, monkeypatch: pytest.MonkeyPatch) -> None:
    """The gateway ends the link when the certificate does."""
    made = dt.datetime.now(dt.UTC) - dt.timedelta(days=1, seconds=-5)
    monkeypatch.setattr(certs.folder, "now_utc", lambda: made)
    certs.folder.issue(secured.folder, "dora", "operator", days=1)
    with secured.client("dora") as client:
        wait_until(lambda: not client.connected, "its end", 60)
        with pytest.raises(DisconnectedError, match=r"dora\.pem expired on"):
            client.state(timeout_s=1)


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


def test_the_documented_passwords_let_those_in_who_have_one(tmp_path: Path) -> None:
    page = Path(certs.__file__).parents[2] / "docs/certificates.md"
    _, gateways, _, laptops, *_ = page.read_text().partition("## Passwords instead")[2].split("```")
    port, users, files = free_port(), tmp_path / "users.txt", (tmp_path / "gateway.json5", tmp_path / "anna.json5")
    users.write_text("anna:PASSWORD\n")
    for path, block in zip(files, (gateways, laptops), strict=True):
        text = block.removeprefix("json5").replace("robot.local:7447", f"127.0.0.1:{port}")
        path.write_text(text.replace("/etc/hexapod-gateway/zenoh/users.txt", str(users)))
    gateway, anna = files
    with Gateway(tmp_path, {"zenoh": {"config": str(gateway), "listen": [f"tcp/0.0.0.0:{port}"]}}):
        with Client(zenoh_config=anna) as client:
            assert client.start_leg(1, 90, 45, 120).accepted
        anna.write_text(anna.read_text().replace("PASSWORD", "another"))
        with pytest.raises(ZenohError, match="wants a password"), Client(zenoh_config=anna):
            pass


def test_off_loopback_it_does_not_start(tmp_path: Path) -> None:
    with Gateway(tmp_path, {"zenoh": {"listen": [f"tcp/0.0.0.0:{free_port()}"]}}, wait=False) as gateway:
        assert gateway.child.wait() == 2
        (line,) = gateway.child.stderr.splitlines()
        assert "would let anyone on the network move the robot" in line


# ---- what a laptop says that does not reach the robot


def without_a_role(secured: Secured) -> str:
    """Return the Zenoh file of a laptop that shows the robot's own certificate."""
    text = (secured.folder / "anna.json5").read_text()
    file = secured.folder / "nobody.json5"
    file.write_text(text.replace("anna.pem", "gateway.pem").replace("anna.key", "gateway.key"))
    return str(file)


def said(*arguments: str) -> list[str]:
    """Return the message of a Stop that does not come through."""
    done = run_here("stop", "--timeout", "1", *arguments)
    assert done.returncode == 4, done
    return [line.removeprefix("hexapod-gateway: ") for line in done.stderr.splitlines()]


STEPS: Final[dict[str, tuple[Callable[[Secured], list[str]], str]]] = {
    "an unknown name": (
        lambda _: ["--connect", "tcp/robot.invalid:7447"],
        "no gateway answers on tcp/robot.invalid:7447: name: robot.invalid is unknown … → check the name",
    ),
    "a port where nothing listens": (
        lambda _: ["--connect", f"tcp/{HOST}:{free_port()}"],
        f"TCP: {HOST} rejects port … nothing listens there … Without a robot: hexapod-gateway run --sim",
    ),
    "plain TCP to a port with TLS": (
        lambda robot: ["--connect", f"tcp/{HOST}:{robot.port}"],
        "TLS: the port wants TLS, and you dial it without → dial tls/…, and give --zenoh-config",
    ),
    "no certificate": (
        lambda robot: ["--connect", f"tls/{HOST}:{robot.port}"],
        "certificate: the robot wants a certificate, and you have none",
    ),
    "a host that the certificate does not name": (
        lambda robot: ["--connect", f"tls/localhost:{robot.port}", "--zenoh-config", str(robot.folder / "anna.json5")],
        "TLS: the robot's certificate does not name localhost → dial it by a name that it has",
    ),
    "an observer": (
        lambda robot: ["--zenoh-config", str(robot.folder / "otto.json5")],
        "no gateway answered: role: you may not command, as observer → ",
    ),
    "a certificate without a role": (
        lambda robot: ["--zenoh-config", without_a_role(robot)],
        "role: the connection is open, but your certificate is of gateway, which is no role",
    ),
}


@pytest.mark.full
@pytest.mark.parametrize("step", STEPS)
def test_one_line_names_the_step_and_what_to_do(secured: Secured, step: str) -> None:
    arguments, says = STEPS[step]
    (line,) = said(*arguments(secured))
    for part in says.split(" … "):
        assert part in line


@pytest.mark.full
def test_a_certificate_of_another_ca_is_rejected(secured: Secured, tmp_path: Path) -> None:
    certs.folder.init(tmp_path / "E", [HOST], port=secured.port)
    certs.folder.issue(tmp_path / "E", "eve", "operator")
    (line,) = said("--zenoh-config", str(tmp_path / "E" / "eve.json5"))
    assert "certificate: the robot's certificate is of another CA than yours" in line
    # A laptop that trusts the robot's CA, with a certificate of another CA.
    shutil.copy(secured.folder / "ca.pem", tmp_path / "E" / "ca.pem")
    (line,) = said("--zenoh-config", str(tmp_path / "E" / "eve.json5"))
    assert "certificate: the robot does not know the CA of your certificate" in line


def names(done: Ended, verdict: str) -> list[str]:
    return [line[9:24].strip() for line in done.stdout.splitlines() if line.startswith(f"{verdict} ")]


@pytest.mark.full
def test_check_from_a_laptop_names_each_step_of_the_way(secured: Secured) -> None:
    done = run_here("check", "--zenoh-config", str(secured.folder / "anna.json5"))
    assert done.returncode == 0, done
    assert names(done, "failure") == []
    way = ["certificate", "certificate", "name", "TCP", "TLS", "certificate", "role", "gateway"]
    assert [name for name in names(done, "ok") if name in way] == way
    assert done.stdout.splitlines()[-1].startswith("This machine can reach the gateway")
