"""Who is shut out at a running gateway, over TLS: two CAs at once, a clock in 1970, a list that comes as a file."""

import datetime as dt
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

import pytest
import zenoh

from gateway import certs
from gateway.client import Client
from gateway.errors import ZenohError
from gateway.people.client.requests import Identity
from gateway.people.tools import revoking
from schemas.keys import LEASE
from schemas.lease import LeaseAck
from schemas.telemetry import GatewayState, Reason, RevocationsReport
from tests.support.certs_folder import NOW
from tests.support.child import Child
from tests.support.command import Ended, run_here
from tests.support.gateway_process import COMMAND, Gateway, free_port
from tests.support.heard import states

HOST = "127.0.0.1"
CLOCK = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <time.h>
static int (*real)(clockid_t, struct timespec *);
static long offset;
int clock_gettime(clockid_t id, struct timespec *now) {
    if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
    int result = real(id, now);
    if (id == CLOCK_REALTIME || id == CLOCK_REALTIME_COARSE) {
        if (!offset) offset = now->tv_sec - 100;
        now->tv_sec -= offset;
    }
    return result;
}
time_t time(time_t *to) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (to) *to = now.tv_sec;
    return now.tv_sec;
}
"""
"""A program that has this loaded began 100 s after the beginning of 1970, as on a board without a battery."""


class Robot:
    """A folder with the CA, and a copy of what the robot has of it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.own, self.state = folder / "D", folder / "robot", folder / "state"
        self.state.mkdir()
        self.port = free_port()
        certs.folder.init(self.folder, [HOST], port=self.port)
        for name in ("anna", "bert"):
            certs.folder.issue(self.folder, name, "operator")
        self.copy()

    def copy(self) -> None:
        """To the robot: what docs/certificates.md names, and no list."""
        self.own.mkdir(exist_ok=True)
        for name in ("ca.pem", "gateway.pem", "gateway.key", "gateway.json5"):
            shutil.copy(self.folder / name, self.own)

    def start(self, **environment: str) -> Gateway:
        settings: dict[str, dict[str, Any]] = {
            "zenoh": {"config": str(self.own / "gateway.json5"), "listen": [f"tls/{HOST}:{self.port}"]}
        }
        return Gateway(self.own, settings, env={"STATE_DIRECTORY": str(self.state), **environment})

    def client(self, file: Path, timeout_s: float = 5) -> Client:
        return Client(None, zenoh_config=file, source=file.stem, timeout_s=timeout_s, explain=False)

    def laptop(self, name: str) -> Client:
        return self.client(self.folder / f"{name}.json5")

    def keep(self, gateway: Gateway) -> Ended:
        """`hexapod-gateway revoke FILE` on the robot."""
        with patch.dict(os.environ, STATE_DIRECTORY=str(self.state)):
            return run_here("revoke", str(self.folder / "revoked.crl"), "--config", str(gateway.config))

    def revoke(self, name: str) -> Ended:
        """`hexapod-gateway certs revoke NAME` where the CA is, over bert's connection."""
        bert = ("--zenoh-config", str(self.folder / "bert.json5"))
        return run_here("certs", "revoke", name, "--dir", str(self.folder), "--to", f"tls/{HOST}:{self.port}", *bert)


@pytest.fixture(name="robot")
def make_robot(tmp_path: Path) -> Robot:
    return Robot(tmp_path)


def may_command(client: Client) -> bool:
    """Whether an emergency stop of this client arrives, which no stall of the machine lets be rejected."""
    try:
        return client.estop().accepted
    except ZenohError:
        return False


def shut_out(robot: Robot, file: Path) -> None:
    """In a second, which is long for a laptop that is let in."""
    with pytest.raises(ZenohError), robot.client(file, timeout_s=1) as laptop:
        laptop.state()


MOMENT: Final = dt.timedelta(seconds=0.1)


def since(state: GatewayState) -> dt.datetime:
    """When this gateway began."""
    return state.time - dt.timedelta(seconds=state.uptime_s)


def lost(robot: Robot) -> Path:
    """The files of anna as the thief has them."""
    stolen = robot.folder.with_name("stolen")
    stolen.mkdir()
    for name in ("ca.pem", "anna.pem", "anna.key", "anna.json5"):
        shutil.copy(robot.folder / name, stolen)
    return stolen / "anna.json5"


@pytest.fixture(scope="session")
def in_1970(tmp_path_factory: pytest.TempPathFactory) -> str:
    """What LD_PRELOAD is to be."""
    folder = tmp_path_factory.mktemp("clock")
    (folder / "clock.c").write_text(CLOCK)
    made = folder / "clock.so"
    subprocess.run(["gcc", "-shared", "-fPIC", "-O1", "-o", made, folder / "clock.c", "-ldl"], check=True)
    seen = subprocess.run(
        [sys.executable, "-c", "import time; print(time.gmtime().tm_year)"],
        env={**os.environ, "LD_PRELOAD": str(made)}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert seen.stdout == "1970\n"
    return str(made)


def test_with_a_clock_in_1970_the_list_is_kept_nobody_gets_in_and_the_log_says_why(robot: Robot, in_1970: str) -> None:
    stolen = lost(robot)
    certs.moving.revoke(robot.folder, "anna")
    with robot.start(LD_PRELOAD=in_1970) as gateway:
        shut_out(robot, robot.folder / "bert.json5")
        assert "this robot's clock is wrong: it shows 1970-01-01" in gateway.child.stdout + gateway.child.stderr
        command = [*COMMAND, "revoke", str(robot.folder / "revoked.crl"), "--config", str(gateway.config)]
        kept = Child(command, {**os.environ, "STATE_DIRECTORY": str(robot.state), "LD_PRELOAD": in_1970})
        assert kept.wait() == 0, str(kept)
        kept.close()
        assert "list 1 shuts out operator-00" in kept.stdout
    with robot.start(LD_PRELOAD=in_1970) as gateway:
        assert "list 1 shuts out operator-00" in gateway.child.stdout + gateway.child.stderr
    with robot.start(), robot.laptop("bert") as bert:  # the clock is set
        assert may_command(bert)
        shut_out(robot, stolen)


def test_a_list_as_a_file_is_older_newer_or_of_another_ca(robot: Robot, tmp_path: Path) -> None:
    first, second = certs.moving.revoke(robot.folder, "anna"), certs.moving.revoke(robot.folder, "operator-40")
    with robot.start() as gateway:
        for data, code, sentence in (
            (second.pem, 0, "list 2 shuts out operator-00, operator-40"),
            (second.pem, 0, "List 2 is in force already"),
            (first.pem, 1, "its number is 1, and number 2 is in force"),
            (second.pem[:-60], 2, "no list of `hexapod-gateway certs revoke`"),
            (b"", 2, "no list of `hexapod-gateway certs revoke`"),
        ):
            (robot.folder / "revoked.crl").write_bytes(data)
            child = robot.keep(gateway)
            assert (child.returncode, sentence in child.stdout + child.stderr) == (code, True), str(child)
            assert "Traceback" not in child.stderr
        certs.folder.init(tmp_path / "other", [HOST])
        certs.folder.issue(tmp_path / "other", "carl", "operator")
        certs.moving.revoke(tmp_path / "other", "carl")
        shutil.copy(tmp_path / "other" / "revoked.crl", robot.folder / "revoked.crl")
        child = robot.keep(gateway)
        assert (child.returncode, "not signed by a CA of this robot" in child.stderr) == (2, True)
        assert (robot.state / "revoked.crl").read_bytes() == second.pem


def test_a_robot_that_is_off_gets_its_list_later(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(revoking, "ANSWER_S", 0.1)
    ended = robot.revoke("anna")
    assert ended.returncode == 1
    assert f"Not confirmed by {HOST}. Once they are there: " in ended.stderr
    assert ended.stdout.startswith(f"{robot.folder}/revoked.crl: list 1 shuts out operator-00."), "it is signed"
    shutil.copy(robot.folder / "revoked.crl", robot.own)  # whoever copies the folder brings it along
    with robot.start() as gateway:
        assert "list 1 shuts out operator-00" in gateway.child.stdout + gateway.child.stderr


def test_a_restored_backup_lets_nobody_in_who_was_shut_out_since(robot: Robot) -> None:
    """The service keeps to the newest list that it has seen, publishes that, and puts it right."""
    first, backup = certs.moving.revoke(robot.folder, "operator-40"), robot.state / "revoked.crl"
    shutil.copy(robot.folder / "revoked.crl", robot.own)  # where the service has never written it itself
    stolen = lost(robot)
    with robot.start(), robot.laptop("bert") as bert:
        assert bert.state().revocations == RevocationsReport(number=1, date=first.date)
    with robot.start() as gateway:
        newest = certs.moving.revoke(robot.folder, "anna")
        assert robot.keep(gateway).returncode == 0
    backup.write_bytes(first.pem)
    with robot.start() as gateway, robot.laptop("bert") as bert:
        gateway.child.wait_for_output("list 1 was in the place of list 2, which this robot has seen")
        assert bert.state().revocations == RevocationsReport(number=2, date=newest.date)
        assert bert.estop().accepted, "nobody else is kept from stopping it"
        shut_out(robot, stolen)
    assert backup.read_bytes() == newest.pem


def test_a_robot_that_has_lost_its_list_is_noticed_when_the_list_comes_again(robot: Robot) -> None:
    """A new card with an old backup: nothing on the robot knows of the list, and the folder with the CA does."""
    stolen = lost(robot)
    with robot.start():
        assert robot.revoke("anna").returncode == 0
    shutil.rmtree(robot.state)
    robot.state.mkdir()
    with robot.start(), robot.laptop("bert") as bert:
        heard, begun = states(bert), since(bert.state())
        assert "\tgood\t1\n" in run_here("certs", "list", "--dir", str(robot.folder)).stdout
        ended = run_here("certs", "revoke", "--dir", str(robot.folder))
        assert (ended.returncode, ended.stdout) == (0, f"{HOST}: list 1 is in force (brought as bert).\n")
        assert ended.stderr == f"{HOST} had list 1, and has none now: was a backup restored?\n"
        heard.wait(lambda state: since(state) - begun > MOMENT, timeout_s=20)
        shut_out(robot, stolen)


def test_without_a_list_the_service_says_so(robot: Robot) -> None:
    with robot.start() as gateway, robot.laptop("bert") as bert:
        assert "there is no list of revoked certificates" in gateway.child.stdout + gateway.child.stderr
        assert bert.state().revocations is None


def test_two_lists_that_cross(robot: Robot) -> None:
    """Two people with copies of the folder each shut somebody out; both stay out, in whichever order it arrives."""
    theirs = robot.folder.with_name("theirs")
    certs.folder.issue(robot.folder, "carl", "operator")
    shutil.copytree(robot.folder, theirs)
    first = certs.moving.revoke(theirs, "anna").pem.decode()
    with robot.start(), robot.laptop("bert") as bert:
        heard, begun = states(bert), since(bert.state())
        assert bert.revocation(first).accepted
        begun = since(heard.wait(lambda state: since(state) - begun > MOMENT, timeout_s=20))
        ended = robot.revoke("carl")
        assert (ended.returncode, ended.stdout.splitlines()[1:]) == (
            0, [f"{HOST}: list 2 is in force (brought as bert)."],
        ), ended.stderr  # fmt: skip
        assert "list 2 has both" in ended.stderr
        heard.wait(lambda state: since(state) - begun > MOMENT, timeout_s=20)
        answer = bert.revocation(first)
        assert (answer.accepted, answer.reason) == (False, Reason.REVOCATION_DENIED)
        assert "number is 1, and number 2 is in force" in str(answer.detail)
        assert bert.revocation().number == 2


def test_an_observer_may_not_bring_a_list_and_an_operator_may_not_bring_a_false_one(robot: Robot) -> None:
    certs.folder.issue(robot.folder, "otto", "observer")
    made = certs.moving.revoke(robot.folder, "anna").pem.decode()
    with robot.start():
        with robot.laptop("otto") as otto, pytest.raises(ZenohError):
            otto.revocation(made)
        with robot.laptop("bert") as bert:
            assert (bert.revocation().number, bert.revocation().revoked) == (0, None)
            for false in ("", "x", made[:200], made.replace("A", "B")):
                answer = bert.revocation(false)
                assert (answer.accepted, answer.reason) == (False, Reason.REVOCATION_DENIED)
            assert bert.state().uptime_s > 0
            assert not (robot.state / "revoked.crl").exists()


def ask(session: zenoh.Session, request: Mapping[str, Any]) -> LeaseAck:
    reply = next(iter(session.get(LEASE, payload=json.dumps(request)))).ok
    assert reply is not None
    return LeaseAck.model_validate_json(reply.payload.to_bytes())


def test_a_proof_of_somebody_who_is_revoked_is_rejected_even_where_the_link_is_anothers(robot: Robot) -> None:
    """As behind a router: the link is bert's, the proof anna's."""
    stolen = lost(robot)
    certs.moving.revoke(robot.folder, "anna")
    shutil.copy(robot.folder / "revoked.crl", robot.state)
    identity = Identity(stolen.with_suffix(".pem"), stolen.with_suffix(".key"))
    with robot.start(), robot.laptop("bert") as bert:
        for do in ("acquire", "ask", "take"):
            nonce = ask(bert.session, {"do": "challenge"}).nonce
            assert nonce is not None
            proof = identity.prove(do, "anna", nonce)
            answer = ask(bert.session, {"do": do, "source": "anna", "proof": proof})
            assert (answer.accepted, answer.reason) == (False, Reason.LEASE_DENIED)
            assert "proof.certificate is revoked (operator-00)" in str(answer.detail)
        with bert.lease() as lease:
            assert lease.verified


def test_two_cas_for_a_while(robot: Robot) -> None:
    """Laptops of the older and of the newer one are in at once; then only those of the newer one."""
    old_bert = robot.folder.with_name("bert")
    old_bert.mkdir()
    for name in ("ca.pem", "bert.pem", "bert.key", "bert.json5"):
        shutil.copy(robot.folder / name, old_bert)
    certs.moving.replace_ca(robot.folder)
    certs.moving.reissue(robot.folder, "anna")
    robot.copy()
    environment = {"RUNTIME_DIRECTORY": str(robot.state)}
    with robot.start(**environment), robot.client(old_bert / "bert.json5") as bert, robot.laptop("anna") as anna:
        assert may_command(bert)
        assert may_command(anna)
        assert (robot.state / "older-ca").read_text() == "operator-01\n"
        with anna.lease() as lease:
            assert lease.verified
    certs.moving.reissue(robot.folder, "bert")
    certs.folder.renew(robot.folder, "gateway", now=NOW)
    certs.moving.drop_ca(robot.folder)
    robot.copy()
    with robot.start():
        with robot.laptop("bert") as bert, robot.laptop("anna") as anna:
            assert may_command(bert)
            assert may_command(anna)
        shut_out(robot, old_bert / "bert.json5")


def test_todays_files_go_on_with_todays_robot_and_with_one_that_has_a_pool(tmp_path: Path) -> None:
    """The folder that release 1.1 made, as it is; only its port and host are this test's."""
    robot = Robot(tmp_path)
    shutil.rmtree(robot.folder)
    shutil.copytree(Path(__file__).parents[1] / "data" / "certs" / "1.1", robot.folder)
    certs.folder.renew(robot.folder, "gateway", hosts=[HOST])
    laptop = robot.folder / "anna.json5"
    laptop.write_text(
        laptop.read_text().replace(
            json.dumps(["tls/robot.local:7447", "tls/192.0.2.7:7447"]), json.dumps([f"tls/{HOST}:{robot.port}"])
        )
    )
    assert str(robot.port) in laptop.read_text()
    robot.copy()
    for _ in range(2):
        with robot.start(), robot.laptop("anna") as anna:
            assert may_command(anna)
            with anna.lease() as lease:
                assert lease.verified
        certs.moving.set_pool(robot.own)


def test_check_of_a_laptop_that_was_revoked_says_so_and_a_new_certificate_helps(robot: Robot) -> None:
    """Its TLS is taken, and then its connection is ended, which no router without a robot behind it does."""
    anna = lost(robot)
    with robot.start():
        robot.revoke("anna")
        said = run_here("check", "--zenoh-config", str(anna))
        assert said.returncode == 1
        (line,) = [each for each in said.stdout.splitlines() if each.startswith("failure")]
        assert "the robot ended it: your certificate is revoked, or its places are taken" in line
        assert "namespace" not in line
        remedy = re.search(r"hexapod-gateway (certs issue NAME --role operator)", line)
        assert remedy is not None, line
        run_here(*remedy[1].replace("NAME", "anna2").split(), "--dir", str(robot.folder))
        assert run_here("check", "--zenoh-config", str(robot.folder / "anna2.json5")).returncode == 0
