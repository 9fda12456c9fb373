"""What each certificate opens, with real Zenoh sessions over TLS on loopback.

Nothing is proved by waiting for nothing: what must not arrive is followed, on the same link, by something that must.
"""

import datetime as dt
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from gateway import certs
from gateway.certs import authority
from gateway.certs.files import read_certificate, read_key
from tests.support.gateway_process import free_port
from tests.support.zenoh_actor import Actor

# Good for the gateway's certificate; "localhost" is not among them: the wrong name for a machine that answers to it.
HOST = "127.0.0.1"
COMMANDS = ["hexapod/leg/1/cmd", "hexapod/servo/11/cmd", "hexapod/legs/cmd", "hexapod/estop/cmd", "hexapod/reset/cmd"]
TLS = "transport/link/tls"
TELEMETRY = ["hexapod/state", "hexapod/event", "hexapod/frame"]


@dataclass
class SecuredRobot:
    """A stand-in for the gateway, opened from the gateway.json5 that `init` made, and the folder it came from."""

    gateway: Actor
    zid: str
    folder: Path
    port: int

    def join(self, laptop: Actor, name: str) -> str:
        """Opens a laptop's session with NAME.json5 just as it was issued."""
        return laptop.open(self.folder / f"{name}.json5")


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecuredRobot]:
    with start(tmp_path_factory.mktemp("robot") / "D") as started:
        yield started


@contextmanager
def start(folder: Path) -> Iterator[SecuredRobot]:
    port = free_port()
    certs.folder.init(folder, [HOST], port=port)
    with Actor() as gateway:
        zid = gateway.open(folder / "gateway.json5")
        gateway.serve()
        # Issued while the gateway runs: new laptops need no change on the robot.
        certs.folder.issue(folder, "alice", "operator")
        certs.folder.issue(folder, "bob", "operator")
        certs.folder.issue(folder, "carol", "observer")
        certs.folder.issue(folder, "kitchen", "button")
        yield SecuredRobot(gateway, zid, folder, port)


def laptop(name: str, *commands: str) -> Any:
    """A fixture: the laptop of that name, in reach of the keys it commands on."""

    @pytest.fixture(scope="module", name=name)
    def joined(robot: SecuredRobot) -> Iterator[Actor]:
        with Actor() as made:
            robot.join(made, name)
            assert all(map(made.matching, commands))
            yield made

    return joined


alice, carol, kitchen = laptop("alice", "hexapod/leg/1/cmd"), laptop("carol"), laptop("kitchen")


@pytest.fixture(autouse=True)
def quiet(robot: SecuredRobot) -> None:
    """Forgets what earlier tests sent."""
    robot.gateway.taken()
    robot.gateway.asked()


def put_and_settle(laptop: Actor, keys: list[str]) -> None:
    """Puts on each key; when the state has answered, all of them have passed the gateway's filter or fallen to it."""
    for key in keys:
        laptop.put(key, "{}")
    assert laptop.get("hexapod/state") == ["answer to "]


def subscribe_and_settle(laptop: Actor, wanted: list[str]) -> None:
    """Subscribes; when the state has answered, the gateway knows: declarations travel ahead of all data on a link."""
    for key in wanted:
        laptop.subscribe(key)
    assert laptop.get("hexapod/state") == ["answer to "]


def keys(samples: list[list[Any]]) -> list[str]:
    return [key for _, key, _ in samples]


# --- an operator


def test_an_operator_cannot_pose_as_the_robot(robot: SecuredRobot, alice: Actor, carol: Actor) -> None:
    """Neither telemetry nor the token nor the answers to others' commands; and it does not overhear them."""
    with Actor() as bob:
        robot.join(bob, "bob")
        carol.watch_alive("hexapod/alive")
        subscribe_and_settle(carol, TELEMETRY)
        bob.subscribe("hexapod/**/cmd")
        bob.queryable("hexapod/**/cmd")
        bob.token("robot9/hexapod/alive")
        put_and_settle(bob, [*TELEMETRY, "hexapod/alive"])
        put_and_settle(alice, COMMANDS)
        assert alice.get("hexapod/leg/1/cmd", "whose?") == ["answer to whose?"]
        assert robot.gateway.asked().count("hexapod/leg/1/cmd") == 1
        assert bob.get("hexapod/state") == ["answer to "]  # what alice sent would have come before
        assert bob.taken() == []
        assert bob.asked() == []
        robot.gateway.put("hexapod/state", "12345")
        # The true ones, and nothing of bob's before them.
        assert sorted(carol.taken(2)) == [["put", "hexapod/alive", 0], ["put", "hexapod/state", 5]]
        assert carol.get_alive("hexapod/alive", 1) == ["hexapod/alive"]
        assert robot.gateway.get_alive("**/hexapod/alive", 1) == ["hexapod/alive"]


def test_an_operators_reach_ends_at_the_commands(robot: SecuredRobot, alice: Actor) -> None:
    """Wildcards that match a command and more than commands do not pass; nothing is half allowed."""
    put_and_settle(alice, ["**", "hexapod/**", "hexapod/leg/1/**", "hexapod/leg/1/*", "*/leg/1/cmd", "**/cmd"])
    assert robot.gateway.taken() == []


# --- a button


def test_a_button_stops_checks_in_and_watches_and_moves_nothing(robot: SecuredRobot, kitchen: Actor) -> None:
    subscribe_and_settle(kitchen, TELEMETRY)
    others = [key for key in COMMANDS if key != "hexapod/estop/cmd"]
    wild = ["hexapod/**/cmd", "hexapod/*/cmd", "hexapod/leg/*/cmd"]
    put_and_settle(kitchen, [*others, *wild, "hexapod/button/cmd", "hexapod/lease/cmd", "hexapod/estop/cmd"])
    kitchen.delete("hexapod/legs/cmd")
    kitchen.delete("hexapod/estop/cmd")
    put_and_settle(kitchen, [])
    assert keys(robot.gateway.taken()) == ["hexapod/estop/cmd"]
    assert kitchen.get("hexapod/estop/cmd", "now") == ["answer to now"]
    assert kitchen.get("hexapod/button/cmd", "alive") == ["answer to alive"]
    for key in (*others, *wild, "hexapod/lease/cmd", "hexapod/calibration/cmd"):
        assert kitchen.get(key, "mine") == []
    robot.gateway.put("hexapod/state", "1234")
    assert kitchen.taken(1) == [["put", "hexapod/state", 4]]


# --- an observer


def test_an_observer_sees_telemetry_only_and_takes_no_wildcard(robot: SecuredRobot, alice: Actor) -> None:
    """A client that may declare a wildcard may declare 20 000 keys below it, each to be compared with all others."""
    with Actor() as watcher, Actor() as wild:
        robot.join(watcher, "carol")
        robot.join(wild, "carol")
        subscribe_and_settle(wild, ["hexapod/*", "**/hexapod/*", "hexapod/secret", "hexapod/**"])
        subscribe_and_settle(watcher, [*TELEMETRY, "hexapod/secret", "hexapod/estop/cmd"])
        put_and_settle(alice, ["hexapod/estop/cmd"])
        for key in ["hexapod/secret", "hexapod/estop/cmd", *TELEMETRY]:
            robot.gateway.put(key, "{}")
        assert sorted(keys(watcher.taken(3))) == sorted(TELEMETRY)
        assert watcher.get_alive("hexapod/alive", 1) == ["hexapod/alive"]
        assert wild.get("hexapod/state") == ["answer to "]
        assert wild.taken() == []

    # The same moves by an operator arrive (above): it is the certificate that makes the difference.


# --- those who hold no role


@pytest.mark.parametrize("role", ["stranger", "gateway", "operator", "Operator-40", "operator-*"])
def test_a_certificate_without_a_role_commands_nothing(robot: SecuredRobot, role: str) -> None:
    """It takes one of our own CA: the session opens, and that is all. An operator's message is received."""
    outcome = []
    for name, common_name in (("someone", role), ("someone-else", "operator-40")):
        forge(robot.folder, name, common_name)
        with Actor() as laptop:
            zid = robot.join(laptop, name)
            assert robot.gateway.identity(zid) == common_name
            laptop.put("hexapod/leg/1/cmd", "{}")
            laptop.delete("hexapod/leg/2/cmd")
            answers = [laptop.get(key) for key in ("hexapod/estop/cmd", "hexapod/state")]
            answers.append(laptop.get_alive("hexapod/alive", int(common_name == "operator-40")))
        assert robot.gateway.wait_gone(zid)  # all it sent has been read by then
        outcome.append((answers, keys(robot.gateway.taken())))
    assert outcome[0] == ([[], [], []], [])
    assert outcome[1] == (
        [["answer to "], ["answer to "], ["hexapod/alive"]],
        ["hexapod/leg/1/cmd", "hexapod/leg/2/cmd"],
    )


# --- those whom TLS turns away


def test_a_link_ends_when_its_certificate_expires(robot: SecuredRobot) -> None:
    forge(robot.folder, "brief", "operator-41", now() - dt.timedelta(days=1, seconds=-3))
    with Actor() as brief:
        zid = robot.join(brief, "brief")
        assert brief.get("hexapod/leg/1/cmd", "in time") == ["answer to in time"]
        assert robot.gateway.wait_gone(zid)
        assert brief.get("hexapod/leg/1/cmd", "too late") == []


# --- helpers


def now() -> dt.datetime:
    return dt.datetime.now(dt.UTC)


def forge(folder: Path, name: str, common_name: str, made: dt.datetime | None = None) -> None:
    """A certificate of the folder's CA that `issue` would not make: any common name, good for a day from `made`."""
    ca = authority.KeyPair(read_certificate(folder / "ca.pem"), read_key(folder / "ca.key"))
    pair = authority.make_leaf(ca, common_name, name, (), 1, made or now())
    (folder / f"{name}.pem").write_bytes(pair.certificate_pem())
    (folder / f"{name}.key").write_bytes(pair.key_pem())
    text = (folder / "alice.json5").read_text()
    (folder / f"{name}.json5").write_text(text.replace('"alice.', f'"{name}.'))
