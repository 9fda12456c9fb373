"""The process: its priority, a signal that arrives inside a Zenoh callback, and its end as a container's first one."""

import logging
import os
import re
import signal
import sys
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
import zenoh

from gateway.host.realtime import LOOP_PRIORITY, PAGE_PRIORITY, RECEIVER_PRIORITY, TIMER_SLACK_NS, ZENOH_NICE
from gateway.people.client.process_end import WalkSignals, keep_signals
from gateway.robot.zenoh_io.session import RUNTIME
from gateway.zenoh.limits import MAX_SESSIONS
from tests.support.child import Child
from tests.support.command import run_program
from tests.support.gateway_process import READY, Gateway, free_port, write_settings

DEPLOY = Path(__file__).parents[2] / "deploy"
SCRIPT = DEPLOY / "container/run-and-stop"
root_only = pytest.mark.skipif(os.geteuid() != 0, reason="only root, or a service that may, gets priority")


def run(program: str, *prefix: str) -> str:
    """Return what a program prints that has imported our module in a process of its own."""
    code = f"from gateway.host.realtime import *\nimport os, threading\n{program}"
    return run_program(*prefix, sys.executable, "-c", code).stdout.strip()


def test_timers_are_on_time_in_every_thread() -> None:
    """Asked of the kernel (PR_GET_TIMERSLACK)."""
    program = """
import ctypes
slack = lambda: ctypes.CDLL(None).prctl(30, 0, 0, 0, 0)
before = slack()
prefer_process()
later = []
thread = threading.Thread(target=lambda: later.append(slack()))
thread.start()
thread.join()
print(before > 1, slack(), *later)
"""
    assert run(program) == f"True {TIMER_SLACK_NS} {TIMER_SLACK_NS}"


@root_only
def test_without_the_right_to_it_everything_stays_as_it_was() -> None:
    without = ("setpriv", "--bounding-set=-sys_nice", "--")
    program = "prefer_process(); print(prefer_thread(7), os.getpriority(os.PRIO_PROCESS, 0))"
    before = str(os.getpriority(os.PRIO_PROCESS, 0))
    assert run(program, "prlimit", "--rtprio=0:0", "--nice=0:0", "--", *without).split() == ["False", before]


UNIT = (DEPLOY / "systemd/hexapod-gateway.service").read_text()


def setting(name: str) -> str:
    """Return what the service unit has."""
    found = re.search(rf"^{name}=(.*)$", UNIT, re.MULTILINE)
    assert found is not None
    return found[1]


def test_the_service_unit_allows_what_the_process_takes() -> None:
    assert (setting("LimitRTPRIO"), setting("LimitNICE")) == (str(LOOP_PRIORITY), str(ZENOH_NICE))
    assert str(MAX_SESSIONS) in RUNTIME
    assert int(setting("TasksMax")) >= MAX_SESSIONS + 40, "an hour of load had 18 to 20 besides Zenoh's two"


@pytest.mark.parametrize(("own", "receiving"), [(None, MAX_SESSIONS), ("(rx:(worker_threads:3))", 3)])
def test_each_session_has_a_thread_of_zenohs_and_only_the_loop_has_priority(
    tmp_path: Path, own: str | None, receiving: int
) -> None:
    """So that no session waits for another that floods; the environment may say otherwise."""
    with Gateway(tmp_path, env=None if own is None else {"ZENOH_RUNTIME": own}) as gateway, gateway.client() as client:
        assert client.state()
        tasks = list(Path(f"/proc/{gateway.child.pid}/task").iterdir())
        assert sum((task / "comm").read_text().startswith("rx-") for task in tasks) == receiving
        if os.geteuid() == 0:
            priorities = {int(task.name): os.sched_getparam(int(task.name)).sched_priority for task in tasks}
            assert priorities[gateway.child.pid] == LOOP_PRIORITY
            found = Counter(priorities.values())
            assert found[LOOP_PRIORITY] == 1 + 2, "those of the emergency stop, too"
            of = "two each for commands and calibration; state, configuration, lease, buttons, revocation"
            assert found[RECEIVER_PRIORITY] == 9, of
            assert found[PAGE_PRIORITY] >= 2, "those that write stdout and stderr among them"
            assert found[0] >= 3


WAIT_S = 20.0


def ask_and_wait(session: zenoh.Session, ended: Callable[..., None]) -> None:
    session.get("nobody/here", zenoh.handlers.Callback(ended, ended, indirect=False))
    threading.Event().wait(WAIT_S)
    pytest.fail("the signal is lost")


@pytest.mark.parametrize(
    ("number", "raised"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)], ids=["ctrl-c", "sigterm"]
)
def test_a_signal_in_a_zenoh_callback_ends_what_waits(
    number: signal.Signals, raised: type[BaseException], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The end of a query that nobody answers is delivered to the thread that asks."""
    monkeypatch.setattr(logging.getLogger("zenoh.handlers"), "filters", [])
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    threads: list[threading.Thread] = []

    def ended(_reply: zenoh.Reply | None = None) -> None:
        threads.append(threading.current_thread())
        os.kill(os.getpid(), number)

    before = signal.signal(number, (lambda *_: sys.exit()) if raised is SystemExit else signal.default_int_handler)
    try:
        with Gateway(tmp_path, {}) as gateway, gateway.client(), zenoh.open(config) as alone, pytest.raises(raised):
            ask_and_wait(alone, ended)
    finally:
        signal.signal(number, before)
    assert threads == [threading.main_thread()]


def test_a_signal_that_is_delivered_again_is_one_signal_for_a_walk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two would stop the robot at once, instead of sitting down."""
    monkeypatch.setattr(logging.getLogger("zenoh.handlers"), "filters", [])
    keep_signals()
    ended: list[bool] = []
    signals = WalkSignals(lambda: ended.append(True)).begin()
    with signals.end():
        for count in (1, 2):
            try:
                signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt:
                logging.getLogger("zenoh.handlers").exception("callback error")  # as Zenoh does
            with pytest.raises(KeyboardInterrupt):
                threading.Event().wait(WAIT_S)
            assert (signals.count, ended) == (count, [True] * (count - 1))


# ---- deploy/container: the script that a container starts, as PID 1 of a namespace, and the limits that it is given


def test_a_container_gets_the_units_devices_groups_and_limits() -> None:
    page = (DEPLOY / "container/README.md").read_text()
    limits = {
        "--ulimit rtprio=": setting("LimitRTPRIO"),
        "--ulimit nice=": str(20 - int(setting("LimitNICE"))),
        "--ulimit nofile=": setting("LimitNOFILE"),
        "--ulimit core=": setting("LimitCORE"),
        "--memory ": setting("MemoryMax").lower(),
        "--pids-limit ": setting("TasksMax"),
        "--stop-timeout ": setting("TimeoutStopSec"),
    }
    for option, value in limits.items():
        assert re.search(rf"{option}{value}(\s|$)", page), (option, value)
    for group in setting("SupplementaryGroups").split():
        assert f"getent group {group} " in page


@pytest.mark.full
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT], ids=["stop", "Ctrl-C"])
def test_as_the_first_process_it_ends_in_time_with_the_gateways_code(tmp_path: Path, number: signal.Signals) -> None:
    config = write_settings(tmp_path / "gateway.toml", {"zenoh": {"listen": [f"tcp/127.0.0.1:{free_port()}"]}})
    with _container(tmp_path, "--sim", "--config", str(config)) as child:
        child.wait_for_output(READY, timeout_s=60)
        children = Path(f"/proc/{child.pid}/task/{child.pid}/children").read_text()
        os.kill(int(children.split()[0]), number)
        assert child.wait() == 0


@pytest.mark.full
def test_whatever_the_end_stops_follow(tmp_path: Path) -> None:
    """Here there is no device, so both say so; the code is the gateway's."""
    config = write_settings(tmp_path / "gateway.toml", {"spi": {"framing": "plain", "device": "/dev/spidev9.9"}})
    with _container(tmp_path, "--config", str(config)) as child:
        assert child.wait() == 3
        assert child.stderr.count("/dev/spidev9.9 does not exist") == 2, child.stderr


def _container(folder: Path, *arguments: str) -> Child:
    """Run the script in a namespace of processes of its own."""
    program = folder / "bin/hexapod-gateway"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m gateway "$@"\n')
    program.chmod(0o755)
    runtime = folder / "run"
    runtime.mkdir()
    environment = {**os.environ, "RUNTIME_DIRECTORY": str(runtime), "PATH": f"{program.parent}:{os.environ['PATH']}"}
    return Child(["unshare", "--pid", "--fork", "--mount-proc", str(SCRIPT), *arguments], environment)
