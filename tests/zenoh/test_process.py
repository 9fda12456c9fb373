"""The process: its priority, and a signal that arrives inside a Zenoh callback."""

import logging
import os
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
from tests.support.command import run_program
from tests.support.gateway_process import Gateway

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


def test_the_service_unit_allows_what_the_process_takes() -> None:
    unit = (Path(__file__).parents[2] / "deploy/systemd/hexapod-gateway.service").read_text()
    assert f"\nLimitRTPRIO={LOOP_PRIORITY}\nLimitNICE={ZENOH_NICE}\n" in unit
    (most,) = [line.partition("=")[2] for line in unit.splitlines() if line.startswith("TasksMax=")]
    assert str(MAX_SESSIONS) in RUNTIME
    assert int(most) >= MAX_SESSIONS + 40, "an hour of load had 18 to 20 besides Zenoh's two"


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
