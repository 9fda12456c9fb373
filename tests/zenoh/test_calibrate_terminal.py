"""`calibrate` in a real terminal, on a running gateway: however somebody leaves it, the leg is stopped."""

import os
import pty
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from gateway.client import Client
from gateway.people.tools.drill.cut_link import CutLink
from schemas.telemetry import GatewayState
from tests.support.fixtures import gateway_fixture, patient
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.heard import states
from tests.support.tmux import LATE_S, Terminal, at_terminal

# Its watchdog has nothing to do with what is stopped within ten seconds.
gateway = gateway_fixture(patient(10_000))
quick = gateway_fixture()  # as it is by default: 250 ms


@pytest.fixture(autouse=True)
def _login(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def runs(state: GatewayState) -> bool:
    return any(servo.running for leg in state.legs for servo in leg.servos)


def start_servo(terminal: Terminal) -> None:
    """Start servo 32 at 90°."""
    terminal.wait("Servo: _")
    terminal.press("3", "2", "Enter")
    terminal.wait("Servo 32 goes there AT ONCE", "Start it at: ")
    terminal.press("Enter")
    terminal.wait("servo 32 RUNS at")


@contextmanager
def calibrating(folder: Path, endpoint: str) -> Iterator[Terminal]:
    """`calibrate`, while servo 32 runs."""
    with at_terminal(folder, "calibrate", endpoint) as terminal:
        start_servo(terminal)
        yield terminal


def stopped_by_a_stop(client: Client) -> None:
    """Nothing runs, and no watchdog had to see to it; nobody drives."""
    state = states(client).wait(lambda state: not runs(state) and state.lease.holder is None)
    assert state.watchdog.expirations == 0


def test_space_escape_q_and_ctrl_c(gateway: Gateway, tmp_path: Path) -> None:
    with gateway.client() as client, calibrating(tmp_path, gateway.endpoint) as terminal:
        heard = states(client)
        for key, says in (("Space", "all six legs are stopped"), ("Escape", "servo 32 is stopped"), ("q", "stopped")):
            assert runs(client.state())
            terminal.press(key)
            terminal.wait("Servo: _", says)
            assert not runs(client.state())
            start_servo(terminal)
        heard.wait(runs)
        terminal.press("C-c")
        assert terminal.wait_for_end() == 0
        assert client.state().lease.holder is None
        assert " isig icanon " in terminal.words
        stopped_by_a_stop(client)


@pytest.mark.parametrize("how", ["terminated", "window closed"])
def test_a_signal_and_a_closed_window(gateway: Gateway, tmp_path: Path, how: str) -> None:
    with gateway.client() as client, calibrating(tmp_path, gateway.endpoint) as terminal:
        assert runs(client.state())
        if how == "terminated":
            os.kill(terminal.pid, signal.SIGTERM)
            assert terminal.wait_for_end() == 0
        else:
            terminal.close()
        stopped_by_a_stop(client)


def test_a_terminal_that_takes_no_more(gateway: Gateway) -> None:
    """Its picture stands still, so nobody sees the servo: it is stopped. The end of the program waits for nothing."""
    master, slave = pty.openpty()
    with gateway.client() as client:
        heard = states(client)
        command = [*COMMAND, "calibrate", "--connect", gateway.endpoint]
        calibrate = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave)
        os.close(slave)
        reads = threading.Event()
        reads.set()
        threading.Thread(target=drain, args=(master, reads), daemon=True).start()
        try:
            heard.wait(lambda state: state.lease.holder is not None)
            os.write(master, b"32\r")
            while not runs(client.state()):
                os.write(master, b"\r")
                time.sleep(0.1)
            reads.clear()
            states(client).wait(lambda state: not runs(state))
            calibrate.terminate()
            assert calibrate.wait(LATE_S) == 0
            stopped_by_a_stop(client)
        finally:
            calibrate.kill()
            calibrate.wait()
            os.close(master)


def drain(master: int, reads: threading.Event) -> None:
    """Read what is drawn, as long as `reads` is set."""
    with suppress(OSError):  # closed
        while reads.is_set():
            os.read(master, 65536)


def test_a_link_that_is_cut_stops_the_servo_and_says_so_and_nothing_starts_when_it_is_back(
    quick: Gateway, tmp_path: Path
) -> None:
    with (
        quick.client() as client,
        CutLink(quick.endpoint) as link,
        calibrating(tmp_path, link.endpoint) as terminal,
    ):
        before = client.state().watchdog.expirations
        terminal.press("i")
        terminal.wait("turned round")
        link.cut()
        states(client).wait(lambda state: not runs(state) and state.watchdog.expirations == before + 1)
        terminal.wait("Servo: _", "NOBODY HAS CONFIRMED THE STOP")
        link.fix()
        terminal.press("Space")
        terminal.wait("all six legs are stopped", "*0° inv")
        assert not runs(client.state())
        start_servo(terminal)  # with the lease, which was lost meanwhile
        assert client.state().lease.holder is not None
        terminal.press("C-c")
        assert terminal.wait_for_end() == 0
        terminal.wait("not written:", "servo 32: +0.00 inverted")
