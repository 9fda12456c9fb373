"""A fleet: three gateways, a router and people, each a process of its own, with certificates as `certs` makes them.

Nothing is proved by waiting for nothing: what must not arrive is followed, on the same links, by something that must.
"""

import json
import os
import shutil
import statistics
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, Self

import pytest
import zenoh

from gateway import certs
from gateway.certs import pool
from gateway.client import Client, leg_payload
from gateway.people.client.requests import Identity
from gateway.zenoh_config import load_config
from schemas import keys
from schemas.lease import LeaseAck
from schemas.telemetry import GatewayState, Mode, Reason
from tests.support.certs_folder import contents, fault
from tests.support.child import Child
from tests.support.command import run_here
from tests.support.gateway_process import COMMAND, READY, free_port, write_settings
from tests.support.heard import states
from tests.support.zenoh_actor import Remote

DEPLOY = Path(__file__).parents[2] / "deploy" / "zenoh"
HOST = "127.0.0.1"
ROBOTS = ["robot-1", "robot-2", "robot-3"]
PEOPLE = [("anna", "operator", "robot-1"), ("otto", "observer", "robot-1"), ("bert", "operator", "robot-2")]
BUFFER_BYTES = 16_384


class Fleet:
    """The router and the gateways, started as docs/certificates.md says."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "D"
        self.port = free_port()
        certs.folder.init(self.folder, [HOST], port=self.port)
        certs.folder.add_robots(self.folder, ROBOTS)
        for name, role, robot in PEOPLE:
            certs.folder.issue(self.folder, name, role, robots=[robot])
        certs.folder.issue(self.folder, "carl", "operator", robots=["robot-1", "robot-3"])
        certs.folder.issue(self.folder, "alma", "operator", robots=[pool.ALL])
        certs.folder.issue(self.folder, "olga", "operator")  # as for a single robot: the router has no rule for her
        self._end = ExitStack()
        self._router = self._end.enter_context(ExitStack())
        self.gateways = [self._gateway(folder, robot) for robot in ROBOTS]  # a robot may well be up first
        for gateway in self.gateways:
            gateway.wait_for_output(READY, timeout_s=30)
        self.start_router()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._end.close()

    def start_router(self) -> None:
        self.router = self._router.enter_context(Remote())
        # With small buffers, so that a laptop that does not read is soon full.
        listen = [f"tls/{HOST}:{self.port}#so_sndbuf={BUFFER_BYTES}"]
        self.router.open(str(self.folder / "router.json5"), {"listen/endpoints": listen})

    def stop_router(self) -> None:
        self._router.close()

    def _gateway(self, folder: Path, robot: str) -> Child:
        settings: dict[str, dict[str, Any]] = {
            "zenoh": {"listen": [], "config": str(self.folder / f"{robot}.json5")},
            "telemetry": {"frames": True},
        }
        config = write_settings(folder / f"{robot}.toml", settings)
        state = folder / f"{robot}-state"
        state.mkdir()
        child = Child(
            [*COMMAND, "run", "--sim", "--config", str(config)], {**os.environ, "STATE_DIRECTORY": str(state)}
        )
        self._end.callback(child.close)
        return child

    def client(self, name: str) -> Client:
        return Client(None, zenoh_config=self.folder / f"{name}.json5", source=name, timeout_s=5)

    def present(self, name: str) -> Client:
        """A client whose robot has come to the router; liveliness says so as it happens, or did."""
        client = self.client(name)
        arrived(client)
        return client

    def raw(self, name: str, **overrides: Any) -> zenoh.Config:
        """A certificate's own session with settings of its holder's choice: no namespace, any key."""
        made = load_config(self.folder / f"{name}.json5")
        for key, value in {"namespace": None, "mode": "client", **overrides}.items():
            made.insert_json5(key, json.dumps(value))
        made.insert_json5("connect/timeout_ms", "5000")
        return made


def arrived(client: Client) -> None:
    here = threading.Event()
    subscriber = client.session.liveliness().declare_subscriber(keys.ALIVE, lambda _: here.set(), history=True)
    assert here.wait(20), "the robot did not come to the router"
    subscriber.undeclare()


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    with Fleet(tmp_path_factory.mktemp("fleet")) as made:
        yield made


@pytest.fixture(scope="module")
def anna(fleet: Fleet) -> Iterator[Client]:
    with fleet.present("anna") as client:
        yield client


@pytest.fixture(scope="module")
def bert(fleet: Fleet) -> Iterator[Client]:
    with fleet.present("bert") as client:
        yield client


def untouched(bert: Client, before: GatewayState) -> None:
    """Robot 2 has heard nothing since; its next command arrives, so all that came sooner had its chance."""
    assert bert.stop(3).accepted
    now = bert.state()
    assert (now.mode, now.commands.accepted, now.commands.rejected) == (
        Mode.IDLE,
        before.commands.accepted + 1,
        before.commands.rejected,
    )


def test_an_operator_commands_the_own_robot_and_sees_it(anna: Client, bert: Client) -> None:
    before = bert.state()
    heard = states(anna)
    assert anna.start_leg(3, 90, 45, 120).accepted
    heard.wait(lambda state: state.mode is Mode.ACTIVE)
    anna.publish(keys.leg_command(3), leg_payload("set", (91, 45, 120)))
    heard.wait(lambda state: state.legs[2].servos[0].angle_deg == 91)
    anna.session.delete(keys.leg_command(3))
    heard.wait(lambda state: not state.legs[2].servos[0].running)
    assert anna.estop().stop_frames == 6
    heard.wait(lambda state: state.mode is Mode.ESTOPPED)
    assert anna.reset().accepted
    untouched(bert, before)


OTHERS = ["robot-2", "robot-$*", "*", "**"]


@pytest.mark.parametrize("who", ["anna", "robot-1", "otto", "olga", "carl.robot-3"])
def test_nobody_commands_or_sees_the_robot_of_another(fleet: Fleet, anna: Client, bert: Client, who: str) -> None:
    before = bert.state()
    seen: list[str] = []
    with zenoh.open(fleet.raw(who)) as session:
        for robot in OTHERS:
            for key in (f"{robot}/{keys.STATE}", f"{robot}/{keys.EVENT}", f"{robot}/**"):
                wanted = zenoh.KeyExpr.autocanonize(key)
                session.declare_subscriber(
                    wanted,
                    lambda sample: seen.append(str(sample.key_expr)),
                    allowed_origin=zenoh.Locality.REMOTE,
                )
            session.liveliness().declare_subscriber(
                f"{robot}/{keys.ALIVE}", lambda sample: seen.append(str(sample.key_expr)), history=True
            )
            session.put(f"{robot}/{keys.ESTOP}", b"")
            session.put(f"{robot}/{keys.leg_command(3)}", json.dumps(leg_payload("start", (1, 2, 3))))
            session.delete(f"{robot}/{keys.leg_command(3)}")
            for key in (keys.ESTOP, keys.STATE, keys.LEGS_COMMAND):
                assert list(session.get(f"{robot}/{key}", payload="{}", timeout=5)) == []
            assert list(session.liveliness().get(f"{robot}/{keys.ALIVE}", timeout=5)) == []
        # The robot's state goes by meanwhile, to the one who may see it.
        states(bert).wait(lambda _: True, count=3)
        untouched(bert, before)
    own = ("robot-1/", "robot-3/") if who.startswith("carl") else "robot-1/"
    assert not [key for key in seen if not key.startswith(own)]
    assert anna.state().mode is Mode.IDLE


def test_a_robot_does_not_speak_for_another(fleet: Fleet, bert: Client) -> None:
    """Neither a forged state nor a forged answer or sign of life of robot 2 comes to its operator."""
    with zenoh.open(fleet.raw("robot-3")) as session:
        raw = bert.session.declare_subscriber(keys.STATE, zenoh.handlers.RingChannel(100))
        session.declare_queryable(f"robot-2/{keys.ESTOP}", lambda query: query.reply(query.key_expr, "forged"))
        session.put(f"robot-2/{keys.STATE}", "forged")
        # An own sign of life goes the same way after it, and is seen by who may see it.
        session.put(f"robot-3/{keys.STATE}", "the end")
        states(bert).wait(lambda _: True, count=3)
        while (sample := raw.handler.try_recv()) is not None:
            GatewayState.model_validate_json(sample.payload.to_bytes())
        assert bert.estop().stop_frames == 6
        assert bert.reset().accepted


def asked(session: zenoh.Session, key: str, request: dict[str, Any]) -> LeaseAck:
    (reply,) = session.get(key, payload=json.dumps(request), timeout=5)
    assert reply.ok is not None
    return LeaseAck.model_validate_json(reply.ok.payload.to_bytes())


def test_each_robot_has_its_own_driver_through_the_router(anna: Client, bert: Client) -> None:
    with anna.lease() as first, bert.lease() as second:
        assert (first.holder, first.verified) == ("anna", True)
        assert (second.holder, second.verified) == ("bert", True)
        assert anna.start_leg(3, 90, 45, 120).accepted
        assert (anna.state().lease.holder, bert.state().lease.holder) == ("anna", "bert")
        assert anna.stop().accepted


@pytest.mark.parametrize(
    ("name", "robots"), [("carl", ["robot-1", "robot-3"]), ("alma", ["robot-1", "robot-2", "robot-3"])]
)
def test_one_certificate_drives_several_robots(fleet: Fleet, name: str, robots: list[str]) -> None:
    with ExitStack() as end:
        clients = [end.enter_context(fleet.present(f"{name}.{robot}")) for robot in robots]
        for client in clients:
            lease = end.enter_context(client.lease())
            assert (lease.holder, lease.verified) == (name, True)
            assert client.start_leg(3, 90, 45, 120).accepted
            assert client.stop().accepted


@pytest.mark.parametrize("do", ["acquire", "ask", "take"])
def test_a_certificate_for_one_robot_drives_no_other(fleet: Fleet, anna: Client, bert: Client, do: str) -> None:
    key = f"robot-2/{keys.LEASE}"
    with zenoh.open(fleet.raw("anna")) as session:
        assert list(session.get(key, payload='{"do": "challenge"}', timeout=5)) == []
    identity = Identity(fleet.folder / "anna.pem", fleet.folder / "anna.key")
    with zenoh.open(fleet.raw("bert")) as session, bert.lease():  # even if he lends her his way
        nonce = asked(session, key, {"do": "challenge"}).nonce or ""
        request = {"do": do, "source": "anna", "proof": identity.prove(do, "anna", nonce)}
        answer = asked(session, key, request)
        assert (answer.accepted, answer.reason) == (False, Reason.LEASE_DENIED), answer
        assert bert.state().lease.holder == "bert"
    assert anna.state().lease.holder is None


@pytest.fixture(name="copy")
def copied_folder(fleet: Fleet, tmp_path: Path) -> Path:
    """A folder of the same CA: other tests find all their people."""
    return Path(shutil.copytree(fleet.folder, tmp_path / "copy"))


def revoke(folder: Path, *arguments: str) -> tuple[int, list[str], str]:
    """Exit code, the lines of robots, and remarks."""
    ended = run_here("certs", "revoke", *arguments, "--dir", str(folder))
    return ended.returncode, [line for line in ended.stdout.splitlines() if line.startswith("robot-")], ended.stderr


def test_whoever_leaves_is_shut_out_at_all_robots_and_one_that_is_away_is_named(
    fleet: Fleet, copy: Path, tmp_path: Path
) -> None:
    certs.folder.issue(copy, "lena", "operator", robots=[pool.ALL])
    certificate, key_file = (Path(shutil.copy(copy / f"lena.{kind}", tmp_path)) for kind in ("pem", "key"))
    stolen = Identity(certificate, key_file)
    certs.folder.add_robots(copy, ["robot-away"])
    code, robots, remarks = revoke(copy, "lena")
    newest = certs.folder.revoked(copy)
    assert newest is not None
    number = newest.number
    assert robots == [f"{robot}: list {number} is in force (brought as alma)." for robot in ROBOTS], remarks
    assert code == 1, "one has not confirmed it"
    assert "\nNot confirmed by robot-away. " in remarks
    rows = [line.split("\t") for line in run_here("certs", "list", "--dir", str(copy)).stdout.splitlines()]
    confirmed = {row[0]: row[-1] for row in rows if row[1].startswith("robot.")}
    assert confirmed == {**dict.fromkeys(ROBOTS, str(number)), "robot-away": f"not {number}"}
    for robot in ROBOTS:
        with fleet.present(f"alma.{robot}") as client, zenoh.open(fleet.raw(f"alma.{robot}")) as session:
            in_force = client.state().revocations
            assert in_force is not None
            assert in_force.number == number
            key = f"{robot}/{keys.LEASE}"
            nonce = asked(session, key, {"do": "challenge"}).nonce or ""
            proof = stolen.prove("take", "lena", nonce)
            answer = asked(session, key, {"do": "take", "source": "lena", "proof": proof})
            assert "proof.certificate is revoked" in str(answer.detail)


def test_robots_with_lists_of_two_copies_of_the_folder_all_get_one_with_both(copy: Path, tmp_path: Path) -> None:
    """Also the first one, which had confirmed the list before by then."""
    theirs = Path(shutil.copytree(copy, tmp_path / "theirs"))
    assert revoke(theirs, "operator-40.robot-2", "--to", "robot-2")[0] == 0
    code, robots, remarks = revoke(copy, "operator-41.robot-1")
    newest = certs.folder.revoked(copy)
    assert newest is not None
    assert {"operator-40.robot-2", "operator-41.robot-1"} <= newest.common_names
    assert (code, len(robots)) == (0, 4), remarks
    assert f"robot-2 had list {newest.number - 1}; list {newest.number} has both." in remarks
    assert robots[-1].startswith(f"robot-1: list {newest.number} ")
    assert certs.confirmed.numbers(copy) == dict.fromkeys(ROBOTS, newest.number)


def test_in_a_fleet_a_list_goes_to_robots_and_not_to_hosts(copy: Path) -> None:
    before = contents(copy)
    assert revoke(copy, "anna", "--to", HOST)[0] == 2
    assert revoke(copy, "anna", "--zenoh-config", str(copy / "bert.json5"))[0] == 2
    assert contents(copy) == before


def test_people_who_ask_and_do_not_read_hold_no_other_robots_stop_up(fleet: Fleet, bert: Client) -> None:
    """The router has two threads that receive from all links: a link that is full is given up before these wait."""
    endpoint = f"tls/{HOST}:{fleet.port}#so_rcvbuf={BUFFER_BYTES}"
    options = ["--source", "deaf", "--mark", "90", "--zenoh-config", str(fleet.folder / "anna.json5")]
    took_ms = []
    command = [sys.executable, "-m", "tests.net.publisher", endpoint, *options]
    with ExitStack() as end, ThreadPoolExecutor(1) as pool:
        deaf = [end.enter_context(closing(Child(command, os.environ))) for _ in range(2)]
        zids = [json.loads(child.wait_for_line(0, 20))["zid"] for child in deaf]
        for child in deaf:
            child.ask("deaf-flood 1 2 3", 10)
        given_up = [pool.submit(fleet.router.wait_given_up, zid, 15) for zid in zids]
        while not all(future.done() for future in given_up):
            asked_s = time.monotonic()
            assert bert.estop().stop_frames == 6
            took_ms.append((time.monotonic() - asked_s) * 1000)
        assert all(future.result() for future in given_up), "they were to be full of answers that they do not read"
    print(f"{len(took_ms)} emergency stops, p50 {statistics.median(took_ms):.1f} ms, max {max(took_ms):.1f} ms")
    assert max(took_ms) < 500
    assert bert.reset().accepted


def test_routers_federate(fleet: Fleet, anna: Client, bert: Client) -> None:
    """Through a second router that dials the first: the own robot, once each, and no other."""
    port = free_port()
    with Remote() as second:
        addresses = {"listen/endpoints": [f"tls/{HOST}:{port}"], "connect/endpoints": [f"tls/{HOST}:{fleet.port}"]}
        second.open(str(fleet.folder / "router.json5"), addresses)
        far = Client(f"tls/{HOST}:{port}", zenoh_config=fleet.folder / "anna.json5", source="far", timeout_s=5)
        with far, zenoh.open(fleet.raw("anna", **{"connect/endpoints": [f"tls/{HOST}:{port}"]})) as stray:
            arrived(far)
            heard, before = states(far), far.state().commands.accepted
            others = bert.state()
            assert far.start_leg(4, 90, 90, 90).accepted
            far.publish(keys.leg_command(4), leg_payload("set", (91, 90, 90)))
            heard.wait(lambda state: state.legs[3].servos[0].angle_deg == 91)
            assert far.stop().accepted
            assert far.state().commands.accepted == before + 3
            stray.put(f"robot-2/{keys.ESTOP}", b"")
            assert list(stray.get(f"robot-2/{keys.STATE}", timeout=5)) == []
            untouched(bert, others)
    assert anna.state().mode is Mode.IDLE


def test_robots_and_people_come_back_after_the_router(fleet: Fleet, anna: Client) -> None:
    """A leg that runs while the router dies is stopped; then the same sessions work on."""
    heard = states(anna)
    assert anna.start_leg(2, 90, 90, 90).accepted
    fleet.stop_router()
    count = len(heard.all)
    fleet.start_router()
    heard.wait(lambda _: True, count=count + 1, timeout_s=15)
    state = anna.state()
    assert state.mode is Mode.IDLE
    assert state.watchdog.expirations >= 1
    assert anna.start_leg(2, 90, 90, 90).accepted
    assert anna.stop().accepted


def test_a_robot_that_is_not_there_has_no_people(fleet: Fleet) -> None:
    said = fault(lambda: certs.folder.issue(fleet.folder, "nina", "operator", robots=["robot-9"]))
    assert said.endswith("has no robot 'robot-9': add it with `hexapod-gateway certs robot robot-9`")


@pytest.mark.parametrize("name", ["robot-1", "anna", "gateway", "a/b", "*", "r" * 49])
def test_a_robots_name_is_a_free_one(fleet: Fleet, name: str) -> None:
    before = contents(fleet.folder)
    assert name in fault(lambda: certs.folder.add_robots(fleet.folder, ["robot-4", name]))
    assert contents(fleet.folder) == before


def test_the_files_in_deploy_are_those_that_certs_makes_also_anew_without_a_new_robot(tmp_path: Path) -> None:
    certs.folder.init(tmp_path, ["router.local"])
    certs.folder.add_robots(tmp_path, ROBOTS[:2])
    certs.folder.add_robots(tmp_path, ROBOTS[2:])
    assert (tmp_path / "router.json5").read_text() == (DEPLOY / "router.json5").read_text()
    assert (tmp_path / "robot-1.json5").read_text() == (DEPLOY / "gateway.json5").read_text()
    (tmp_path / "router.json5").write_text("// of an older version\n")
    assert "router.json5 anew" in run_here("certs", "robot", "--dir", str(tmp_path)).stdout
    assert (tmp_path / "router.json5").read_text() == (DEPLOY / "router.json5").read_text()
