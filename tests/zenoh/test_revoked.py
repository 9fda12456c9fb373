"""Who is shut out at a running gateway, over TLS: a clock in 1970, a robot that was off, lists that cross."""

import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import pytest

from gateway import certs
from gateway.client import Client
from gateway.errors import GatewayError, ZenohError
from gateway.people.client.lease_requests import Identity
from schemas.calibration import ServoChange
from schemas.gateway_state import GatewayState
from schemas.robot import LEGS
from schemas.words import Mode, Reason
from tests.support.child import Child
from tests.support.command import Ended, run_here
from tests.support.gateway_process import Gateway, free_port
from tests.support.heard import running, states
from tests.zenoh.test_lease import ask

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
BACK_S: Final = 3.0
"""Within which everybody else is back, as it was promised; where this machine is busy, TIMES what loading takes it."""
TIMES: Final = 3
LOADING: Final = "import gateway.cli, gateway.onboard.serve, gateway.robot.service"
"""Half of what a gateway does that starts anew."""
POSE: Final = (90, 45, 120)
KNOCKING: Final = """
import sys, time
from contextlib import suppress
from pathlib import Path
import zenoh
from gateway.zenoh.config import load_config
while True:
    config = load_config(Path(sys.argv[1]))
    config.insert_json5("connect/timeout_ms", "500")
    with suppress(zenoh.ZError):
        session = zenoh.open(config)
        session.put("hexapod/estop/cmd", b"")
        session.close()
    print("tried", flush=True)
    time.sleep(0.05)
"""
"""Opens a session again and again, and presses the emergency stop in each."""


class Robot:
    """A folder with the CA, and a copy of what the robot has of it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.own, self.state = folder / "D", folder / "robot", folder / "state"
        self.state.mkdir()
        self.port = free_port()
        certs.folder.init(self.folder, [HOST], port=self.port)
        for name in ("anna", "bert"):
            certs.folder.issue(self.folder, name, "operator")
        self.own.mkdir()
        for name in ("ca.pem", "gateway.pem", "gateway.key", "gateway.json5"):  # docs/certificates.md; and no list
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

    def revoke(self, name: str) -> Ended:
        """Run `hexapod-gateway certs revoke NAME` where the CA is, over bert's connection."""
        bert = ("--zenoh-config", str(self.folder / "bert.json5"))
        return run_here("certs", "revoke", name, "--dir", str(self.folder), "--to", f"tls/{HOST}:{self.port}", *bert)


@pytest.fixture(name="robot")
def make_robot(tmp_path: Path) -> Robot:
    return Robot(tmp_path)


def shut_out(robot: Robot, file: Path) -> None:
    """Return whether a laptop is shut out for a second, which is long for one that is let in."""
    with pytest.raises(ZenohError), robot.client(file, timeout_s=1) as laptop:
        laptop.state()


def in_force(number: int) -> Callable[[GatewayState], bool]:
    """Return whether a state is of a gateway that has started with this list."""
    return lambda state: state.revocations is not None and state.revocations.number == number


def lost(robot: Robot) -> Path:
    """Return the files of anna as the thief has them."""
    stolen = robot.folder.with_name("stolen")
    stolen.mkdir()
    for name in ("ca.pem", "anna.pem", "anna.key", "anna.json5"):
        shutil.copy(robot.folder / name, stolen)
    return stolen / "anna.json5"


@pytest.fixture(scope="session")
def in_1970(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return what LD_PRELOAD is to be."""
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
    certs.folder.revoke(robot.folder, "anna")
    with robot.start(LD_PRELOAD=in_1970) as gateway:
        shut_out(robot, robot.folder / "bert.json5")
        gateway.child.wait_for_output("this robot's clock is wrong: it shows 1970-01-01")
    shutil.copy(robot.folder / "revoked.crl", robot.own)
    with robot.start(LD_PRELOAD=in_1970) as gateway:
        gateway.child.wait_for_output("list 1 shuts out operator-00")
    with robot.start(), robot.laptop("bert") as bert:  # the clock is set
        assert bert.estop().accepted, "which no stall of the machine lets be rejected"
        shut_out(robot, stolen)


def test_a_robot_that_has_lost_its_list_gets_it_again(robot: Robot) -> None:
    """A new card with an old backup: nothing on the robot knows of the list, and the folder with the CA does."""
    stolen = lost(robot)
    with robot.start():
        assert robot.revoke("anna").returncode == 0
    shutil.rmtree(robot.state)
    robot.state.mkdir()
    with robot.start(), robot.laptop("bert") as bert:
        heard = states(bert)
        ended = run_here("certs", "revoke", "--dir", str(robot.folder))
        assert (ended.returncode, ended.stdout.splitlines()[-1]) == (0, "gateway: list 1 is in force."), str(ended)
        heard.wait(in_force(1))
        shut_out(robot, stolen)


def test_two_lists_that_cross(robot: Robot) -> None:
    """Two people with copies of the folder each shut somebody out; both stay out, in whichever order it arrives."""
    theirs = robot.folder.with_name("theirs")
    certs.folder.issue(robot.folder, "carl", "operator")
    shutil.copytree(robot.folder, theirs)
    first = certs.folder.revoke(theirs, "anna").pem.decode()
    with robot.start(), robot.laptop("bert") as bert:
        heard = states(bert)
        assert bert.revocation(first).accepted
        heard.wait(in_force(1))
        ended = robot.revoke("carl")
        said = [f"tls/{HOST}:{robot.port}: list 2 is in force."]
        assert (ended.returncode, ended.stdout.splitlines()[1:]) == (0, said), ended.stderr
        heard.wait(in_force(2))
        answer = bert.revocation(first)
        assert (answer.accepted, answer.reason) == (False, Reason.REVOCATION_DENIED)
        assert "number is 1, and number 2 is in force" in str(answer.detail)
        assert bert.revocation().number == 2


def test_without_a_state_folder_emergency_stop_and_calibration_outlast_the_start_anew(robot: Robot) -> None:
    with robot.start(STATE_DIRECTORY="") as gateway, robot.laptop("bert") as bert:
        heard = states(bert)
        assert bert.calibrate({11: ServoChange(trim_deg=3.5)})
        engaged = bert.estop()
        assert engaged.kept is None
        assert robot.revoke("anna").returncode == 0
        heard.wait(in_force(1))
        state = bert.state()
        assert (state.mode, state.estop, state.estop_source) == (Mode.ESTOPPED, engaged.estop, "bert")
        assert bert.start_leg(1, 90, 90, 90, check=False).reason is Reason.ESTOPPED
        assert (bert.calibration().servos["11"].trim_deg, bert.calibration().revision) == (3.5, 1)
        gateway.child.wait_for_output("is still engaged")
        assert bert.reset().accepted


@contextmanager
def walking(client: Client) -> Iterator[None]:
    """Yield all six legs at 50 Hz meanwhile, with the lease, until it is shut out."""
    ended, begun = threading.Event(), threading.Event()

    def walk() -> None:
        with suppress(GatewayError), client.lease(), client.stream(50) as stream:
            while not ended.is_set():
                stream.set(dict.fromkeys(LEGS, POSE))
                begun.set()

    thread = threading.Thread(target=walk)
    thread.start()
    try:
        assert begun.wait(20)
        yield
    finally:
        ended.set()
        thread.join()


@pytest.mark.alone
def test_revoked_in_mid_walk_and_everybody_else_is_back_within_three_seconds(robot: Robot) -> None:
    """Afterwards her laptop stops nobody, although it presses the emergency stop every 50 ms."""
    stolen = lost(robot)
    with robot.start(HEXAPOD_WATCHDOG__TIMEOUT_MS="2000") as gateway, robot.laptop("bert") as bert:
        seen = states(bert)
        with robot.laptop("anna") as anna, walking(anna):
            answer = bert.revocation(certs.folder.revoke(robot.folder, "anna").pem.decode())
            assert answer.accepted
            revoked_s = time.monotonic()
            back = seen.wait(in_force(1))
            took_s = time.monotonic() - revoked_s
            if took_s >= BACK_S:
                begun_s = time.monotonic()
                subprocess.run([sys.executable, "-c", LOADING], check=True)
                assert took_s < TIMES * (time.monotonic() - begun_s)
            assert (back.mode, back.lease.holder) == (Mode.IDLE, None)
        logged = gateway.child.stderr
        assert 0 < logged.index("kind=revoked") < logged.index("kind=stopping")
        knocking = Child([sys.executable, "-c", KNOCKING, str(stolen)], os.environ)
        with knocking, walking(bert):
            knocking.wait_for_line(40, 20)
            state = bert.state()
            assert state.estop == 0, "none of her emergency stops arrived"
            assert state.watchdog.expirations == 0, "bert's stream was never silent"
            assert running(bert) == [*LEGS]
        gateway.child.wait_for_output("rejected connections with revoked certificates: operator-00")


def test_a_proof_of_somebody_who_is_revoked_is_rejected_even_where_the_link_is_anothers(robot: Robot) -> None:
    """The link is bert's, the proof anna's."""
    stolen = lost(robot)
    certs.folder.revoke(robot.folder, "anna")
    shutil.copy(robot.folder / "revoked.crl", robot.state)
    identity = Identity(stolen.with_suffix(".pem"), stolen.with_suffix(".key"))
    with robot.start(), robot.laptop("bert") as bert:
        for do in ("acquire", "ask", "take"):
            nonce = ask(bert.session, "challenge").nonce
            assert nonce is not None
            proof = identity.prove(do, "anna", nonce)
            answer = ask(bert.session, do, "anna", proof=proof)
            assert (answer.accepted, answer.reason) == (False, Reason.LEASE_DENIED)
            assert "proof.certificate is revoked (operator-00)" in str(answer.detail)
        with bert.lease() as lease:
            assert lease.verified
