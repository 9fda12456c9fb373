"""`watch` in a real terminal, on a running gateway: what stands on the screen, and what its keys do."""

import os
import pty
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from gateway import certs
from gateway.client import Client
from gateway.people.tools.kept_lease import me
from schemas import keys
from schemas.telemetry import GatewayState, Kind, Mode
from tests.support.command import run_here
from tests.support.fixtures import gateway_fixture, patient
from tests.support.gateway_process import COMMAND, Gateway, free_port
from tests.support.heard import events
from tests.support.measuring import MEASURED
from tests.support.tmux import LATE_S, Terminal

pytestmark = [pytest.mark.full, pytest.mark.attended]

PATIENT = patient(10_000, watchdog={"repeats": 0})
"""So that a leg that was started once runs while the test looks at it, and nothing is written that nobody asked for."""


@pytest.fixture(autouse=True)
def _at_rest(gateway: Gateway) -> None:
    with gateway.client() as client:
        client.reset()
        assert client.stop().accepted


gateway = gateway_fixture(PATIENT)


def watching(folder: Path, *arguments: str) -> Terminal:
    return Terminal(folder, [*COMMAND, "watch", *arguments])


@pytest.fixture
def terminal(gateway: Gateway, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Terminal]:
    """`watch`, that has heard the gateway, started by a shell that has exported the size of its window."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("LINES", "24")
    with watching(tmp_path, "--connect", gateway.endpoint) as running:
        running.wait(" 1 ○", "q: quit")
        yield running


def wait_for_state(client: Client, holds: Callable[[GatewayState], bool]) -> GatewayState:
    """Ask until the state is so."""
    deadline = time.monotonic() + LATE_S
    while not holds(state := client.state()):
        assert time.monotonic() < deadline, state
    return state


# ---- what is shown


def test_it_shows_a_running_leg_rejections_and_events(gateway: Gateway, terminal: Terminal) -> None:
    assert terminal.screen.startswith(" IDLE   0 legs running")
    with gateway.client(source="anna") as client:
        assert client.start_leg(3, 90, 45, 120).accepted
        shown = terminal.wait("ACTIVE", "3 ● 90.00°", "● 45.00°", "● 120.00°", "command / 10000 ms")
        assert "1 leg running" in shown
        assert not client.set_leg(4, 1, 2, 3).accepted
        assert not client.set_leg(4, 1, 2, 3).accepted
        terminal.wait("rejected anna 2 (servo_stopped)", "command_rejected anna: servo 41 does not run")
        assert client.stop().accepted
        client.session.put(keys.TELEMETRY, MEASURED.model_dump_json())  # in the gateway's place
        terminal.wait("IDLE", "7.40 V 80 % tilt 0° 31.5 °C", "feet ○1 ●2 ●3 ●4 ●5 ●6")
        terminal.wait("IDLE", "3 ○ —")


def test_a_small_terminal_keeps_the_legs_and_the_stop_key(terminal: Terminal) -> None:
    def is_small(screen: str) -> bool:
        lines = screen.splitlines()
        keys = lines[-1].startswith(" SPACE or e: EMERGENCY STOP")
        return len(lines) == 12 and keys and " 6  ○" in screen and "rejected nobody" not in screen

    terminal.resize(60, 12)
    terminal.wait_for_screen(is_small, "the smaller picture")
    terminal.press("Space")
    terminal.wait("ESTOPPED")
    terminal.resize(20, 2)
    terminal.wait_for_screen(lambda screen: screen.splitlines()[-1] == " SPACE or e: EMERGEN", "its last rows")


# ---- the emergency stop and the reset


def test_the_stop_keys_stop_at_once_and_say_so(gateway: Gateway, terminal: Terminal) -> None:
    with gateway.client() as client:
        for key in ("Space", "e", "E"):
            assert client.start_leg(3, 90, 45, 120).accepted
            terminal.wait("ACTIVE", "3 ● 90.00°")
            heard = events(client)
            terminal.press(key)
            heard.wait(lambda event: event.kind is Kind.ESTOP_ENGAGED)
            shown = terminal.wait("ESTOPPED", "STOPPED: 6 Stop frames written within", "3 ○ —")
            assert "ms after the key" in shown
            assert client.reset().accepted
            terminal.wait("IDLE")


def test_the_reset_asks_first(gateway: Gateway, terminal: Terminal) -> None:
    with gateway.client() as client:
        terminal.press("r")
        terminal.wait("no emergency stop is engaged, so there is nothing to reset")
        assert client.estop().accepted
        terminal.wait("ESTOPPED")
        terminal.press("y")  # no question stands, so it answers none
        terminal.press("r")
        terminal.wait("Leave the emergency stop?")
        terminal.press("n")
        terminal.wait("no reset: the emergency stop stays engaged")
        terminal.press("y")
        terminal.press("r")
        terminal.wait("Leave the emergency stop?")
        assert client.state().mode is Mode.ESTOPPED
        terminal.press("y")
        terminal.wait("IDLE", "reset; nothing moves until it is started again")
        assert client.state().mode is Mode.IDLE
        terminal.press("t")
        terminal.wait("Drive?")
        terminal.press("Space")  # whatever question stands
        shown = terminal.wait("ESTOPPED", "STOPPED: 6 Stop frames")
        assert "Drive?" not in shown


@pytest.mark.parametrize(
    ("program", "answers"),
    [("watch", True), ("watch", False), ("walk", True), ("button", True)],
    ids=["watch", "watch, and nobody answers", "walk", "button"],
)
def test_the_stop_key_works_when_the_terminal_takes_no_more_and_so_does_the_end(
    gateway: Gateway, program: str, answers: bool
) -> None:
    """A terminal that nobody reads: drawing blocks in the middle of a picture, and the key still stops the robot."""
    endpoint = gateway.endpoint if answers else f"tcp/127.0.0.1:{free_port()}"
    master, slave = pty.openpty()
    os.set_blocking(master, True)
    with gateway.client() as client:
        command = [*COMMAND, program, "--connect", endpoint]
        shown = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave)
        try:
            os.close(slave)
            # Its first bytes say that keys come one by one now; the rest stays unread, and fills the pty's 4 KB.
            assert os.read(master, 1)
            wait_for_stuck_writer(shown.pid)
            os.write(master, b" ")
            if answers:
                wait_for_state(client, lambda state: state.mode is Mode.ESTOPPED)
            deadline = time.monotonic() + LATE_S
            while shown.poll() is None and time.monotonic() < deadline:
                os.write(master, b"\x03")  # Ctrl-C; one that is read together with the stop does not count
                with suppress(subprocess.TimeoutExpired):
                    shown.wait(0.2)
            assert shown.returncode == 0
        finally:
            shown.kill()
            shown.wait()
            os.close(master)


def wait_for_stuck_writer(pid: int) -> None:
    """Until a thread of the process waits in the terminal's write, as its kernel stack or wait channel says."""
    deadline = time.monotonic() + LATE_S
    while time.monotonic() < deadline:
        for task in Path(f"/proc/{pid}/task").iterdir():
            with suppress(FileNotFoundError, ProcessLookupError):  # a thread that has ended meanwhile
                number, descriptor = [*(task / "syscall").read_text(encoding="ascii").split(), "", ""][:2]
                if number == str(_WRITE) and int(descriptor, 16) == 1:
                    return
        time.sleep(0.05)
    raise TimeoutError("its drawing never blocked")


_WRITE = {"x86_64": 1, "aarch64": 64}.get(os.uname().machine, 1)


# ---- silence


def test_a_gateway_that_hangs_and_one_that_dies_are_called_silent_and_come_back(tmp_path: Path) -> None:
    listen = {"zenoh": {"listen": [f"tcp/127.0.0.1:{free_port()}"]}}
    with (
        Gateway(tmp_path, {**PATIENT, **listen}) as gateway,
        watching(tmp_path, "--connect", gateway.endpoint, "--timeout", "0.5") as terminal,
    ):
        terminal.wait("IDLE")
        gateway.child.send_signal(signal.SIGSTOP)
        terminal.wait("SILENT for")
        terminal.press("Space")
        terminal.wait("NOT STOPPED, NO ANSWER")
        gateway.child.send_signal(signal.SIGCONT)
        terminal.wait("ESTOPPED", "STOPPED: 6 Stop frames")  # it was asked for until it was confirmed
        with gateway.client() as client:
            assert client.reset().accepted
            assert client.start_leg(3, 90, 45, 120).accepted
            terminal.wait("ACTIVE")
        gateway.child.kill()
        terminal.wait("SILENT for", "was ACTIVE", "The gateway is silent: below is the past", "the gateway fell silent")
        terminal.press("r")
        terminal.wait("Leave the emergency stop?")
        terminal.press("y")
        terminal.wait("NO RESET: nobody answered (an observer's certificate may not reset)")
        terminal.press("Space")
        terminal.wait("NOT STOPPED, NO ANSWER", "switch the servos' power off", "trying again")
        with Gateway(tmp_path, {**PATIENT, **listen}) as again:  # what nobody received is sent again
            shown = terminal.wait("ESTOPPED", "the gateway publishes again", "the gateway was started again")
            assert "SILENT for" not in shown
            assert "NOT STOPPED" not in terminal.wait("STOPPED: 6 Stop frames")
            with again.client() as client:
                assert client.reset().accepted
                assert client.start_leg(5, 10, 20, 30).accepted
            terminal.wait("5 ● 10.00°")


def test_it_waits_for_a_gateway_that_is_not_there_yet_and_asks_one_that_publishes_no_state(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with watching(tmp_path, "--connect", endpoint, "--timeout", "0.3") as terminal:
        terminal.wait("WAITING", endpoint, "no gateway answers on", "trying again")
        terminal.press("t")
        terminal.wait("Drive?")
        terminal.press("y")
        terminal.wait("NOT DONE: there is no connection")
        terminal.press("Space")
        terminal.wait("NOT STOPPED, NO ANSWER")
        with Gateway(tmp_path, {"zenoh": {"listen": [endpoint]}, "telemetry": {"state_hz": 0}}):
            terminal.wait("ESTOPPED", "STOPPED: 6 Stop frames")
            # Longer than silence takes, by the gateway's own time, which passes on the screen by what it asks alone.
            terminal.wait_until(lambda words: words.startswith("ESTOPPED") and up_s(words) >= 3, "time to pass")
            terminal.press("q")
            assert terminal.wait_for_end() == 0


def up_s(words: str) -> int:
    """The uptime in the first line."""
    hours, minutes, seconds = words.partition(" up ")[2].split()[0].split(":")
    return int(hours) * 3600 + int(minutes) * 60 + int(seconds)


# ---- certificates


def test_over_tls_an_operator_stops_and_an_observer_is_informed_that_he_may_not(tmp_path: Path) -> None:
    folder, port = tmp_path / "D", free_port()
    certs.folder.init(folder, ["127.0.0.1"], port=port)
    certs.folder.issue(folder, "anna", "operator")
    certs.folder.issue(folder, "otto", "observer")
    zenoh = {"config": str(folder / "gateway.json5"), "listen": [f"tls/127.0.0.1:{port}"]}
    for name in ("anna", "otto"):
        (tmp_path / name).mkdir()
    with (
        Gateway(tmp_path, {**PATIENT, "zenoh": zenoh}),
        watching(tmp_path / "otto", "--zenoh-config", str(folder / "otto.json5"), "--timeout", "0.5") as otto,
        watching(tmp_path / "anna", "--zenoh-config", str(folder / "anna.json5")) as anna,
        Client(None, zenoh_config=folder / "anna.json5", timeout_s=5) as client,
    ):
        otto.wait("IDLE", f"tls/127.0.0.1:{port}")
        anna.wait("IDLE")
        assert client.start_leg(3, 90, 45, 120).accepted
        for terminal in (otto, anna):
            terminal.wait("ACTIVE", "3 ● 90.00°")
        otto.press("Space")
        otto.wait("NOT STOPPED, NO ANSWER", "an observer's certificate may not stop")
        assert client.state().mode in (Mode.ACTIVE, Mode.IDLE)  # idle: the watchdog, on a slow machine
        anna.press("Space")
        anna.wait("ESTOPPED", "STOPPED: 6 Stop frames")
        shown = otto.wait("ESTOPPED, as its state says", "estop_engaged")
        assert "NOT STOPPED" not in shown


# ---- who is driving


def test_it_shows_the_holder_asks_takes_and_lets_go_at_its_end(
    gateway: Gateway, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    asked, lost = threading.Event(), threading.Event()
    with watching(tmp_path, "--connect", gateway.endpoint) as terminal, gateway.client(source="anna") as anna:
        terminal.wait("IDLE", "0 legs running tcp/")
        terminal.press("a")
        terminal.wait("nobody drives, so there is nobody to ask")
        with anna.lease(on_asked=lambda _: asked.set(), on_lost=lambda _: lost.set()):
            assert anna.start_leg(3, 90, 45, 120).accepted
            terminal.wait("ACTIVE 1 leg running anna? drives", "lease_acquired")
            terminal.press("a")
            terminal.wait("anna is asked, and may hand over", f"{me()[:10]}")
            assert asked.wait(LATE_S)
            assert anna.estop().accepted
            terminal.wait("ESTOPPED")
            terminal.press("r")
            terminal.wait("Leave the emergency stop?")
            terminal.press("y")
            terminal.wait("NO RESET: not_holder: ")
            assert anna.reset().accepted
            terminal.press("t")
            terminal.wait("Take it from anna? All six legs stop first.")
            terminal.press("n")
            terminal.wait("not taken")
            assert not lost.is_set()
            terminal.press("t")
            terminal.wait("Take it from anna?")
            terminal.press("y")
            terminal.wait("IDLE", f"{me()} drives: `send` of this user counts", "3 ○ —")
            assert lost.wait(LATE_S)
        assert anna.start_leg(3, 90, 45, 120).reason == "not_holder"
        assert gateway.run("send", "leg", "3", "start", "90", "45", "120").returncode == 0
        terminal.wait("ACTIVE")
        terminal.press("t")
        terminal.wait("released: commands are taken from anyone again")
        assert anna.state().lease.holder is None
        terminal.press("t")
        terminal.wait("Drive? Nobody else's starts, sets and resets count then")
        terminal.press("y")
        terminal.wait("drives: `send` of this user counts")
        assert anna.state().lease.holder == me()
        terminal.press("q")
        assert terminal.wait_for_end() == 0
        assert anna.state().lease.holder is None
    assert not list((tmp_path / "hexapod-gateway").iterdir())


# ---- the end


def test_a_picture_that_cannot_be_drawn_does_not_stand_still(gateway: Gateway, tmp_path: Path) -> None:
    watch = ["env", "PYTHONIOENCODING=ascii", *COMMAND, "watch", "--connect", gateway.endpoint]
    with Terminal(tmp_path, watch) as terminal:
        assert terminal.wait_for_end() == 1
        assert "hexapod-gateway: this terminal cannot be drawn on ('ascii' codec can't encode" in terminal.words


def test_it_leaves_the_terminal_as_it_found_it(gateway: Gateway, tmp_path: Path) -> None:
    watch = " ".join([*COMMAND, "watch", "--connect", gateway.endpoint])
    with Terminal(tmp_path, ["sh", "-c", f"echo before; {watch}"]) as terminal:
        terminal.wait("IDLE")
        terminal.press("C-c")
        assert terminal.wait_for_end() == 0
        shown = terminal.wait("before", "icanon")
        assert " echo " in shown
        assert "-icanon" not in shown
        assert " isig " in shown


def test_an_unconfirmed_stop_is_reported_once_more_at_the_end(tmp_path: Path) -> None:
    with watching(tmp_path, "--connect", f"tcp/127.0.0.1:{free_port()}", "--timeout", "0.2") as terminal:
        terminal.wait("WAITING")
        terminal.press("e")
        terminal.wait("NOT STOPPED")
        terminal.press("q")
        assert terminal.wait_for_end() == 0
        assert "The emergency stop was NOT confirmed: switch the servos' power off." in terminal.words


OTHERWISE = {
    "watch": (2, "; a program reads hexapod/state and hexapod/event instead", ""),
    "walk": (1, "; without one: --forward 0.1 --seconds 5", ", or give --seconds"),
    "button": (1, "", ", or open the console's /button"),
}
"""What a person is to do without a terminal, and on Windows."""


@pytest.mark.parametrize("program", OTHERWISE)
def test_without_a_terminal_each_program_says_what_else_there_is(program: str, monkeypatch: pytest.MonkeyPatch) -> None:
    code, otherwise, on_windows = OTHERWISE[program]
    name = f"hexapod-gateway: {'walk from the keyboard' if program == 'walk' else program}"
    end = run_here(program)
    assert (end.returncode, end.stdout) == (code, "")
    assert end.stderr.startswith(f"{name} needs a terminal{otherwise}"), end.stderr
    monkeypatch.setitem(sys.modules, "termios", None)
    unix = f"{name} needs a Unix terminal; on Windows, run it in WSL{on_windows}\n"
    assert run_here(program) == (code, "", unix)


def test_a_faulty_file_is_reported_before_the_screen(tmp_path: Path) -> None:
    with watching(tmp_path, "--zenoh-config", str(tmp_path / "absent.json5")) as terminal:
        assert terminal.wait_for_end() == 2
        assert "absent.json5" in terminal.words
