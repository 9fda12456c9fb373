"""What `check` says of a controller of elkapod-2025: its UART, its heartbeat, its answers; and what it writes to it."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gateway.model import elkapod
from gateway.model.elkapod import SHUTDOWN, VALUE_NAMES
from gateway.onboard.check import controller, device
from gateway.onboard.check.table import CheckedRobot, Result, Verdict, results
from gateway.robot.settings import Settings
from gateway.robot.spi import DuplexDevice
from gateway.robot.spi.elkapod_simulator import SimulatedElkapod
from gateway.robot.spi.uart import SerialUart, Uart
from tests.support.machine_tree import MachineTree

MS = 1_000_000
PI_5 = "Raspberry Pi 5 Model B Rev 1.0"


# ---- the UART


class Terminal:
    """A pseudo terminal in place of a UART, and the /proc and /sys of the machine that it is in."""

    def __init__(self, root: Path) -> None:
        self.ours, self._theirs = os.openpty()
        self.path = os.ttyname(self._theirs)
        self.root = root
        MachineTree(root, model=PI_5)

    def console(self, names: str) -> None:
        folder = self.root / "sys/class/tty/console"
        folder.mkdir(parents=True)
        (folder / "active").write_text(f"{names}\n")

    def process(self, number: int, program: str, terminal: int) -> None:
        folder = self.root / f"proc/{number}"
        folder.mkdir()
        (folder / "stat").write_text(f"{number} ({program}) S 1 {number} {number} {terminal} -1 4194560 0\n")

    @property
    def number(self) -> int:
        """As the kernel writes it to /proc/N/stat: pseudo terminals have the major number 136, and small minors."""
        return 136 << 8 | os.minor(os.stat(self.path).st_rdev)

    def close(self) -> None:
        os.close(self.ours)
        os.close(self._theirs)


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    made = Terminal(tmp_path)
    yield made
    made.close()


def looked_at(terminal: Terminal, *, gateway_runs: bool = False) -> Result:
    settings = Settings.model_validate({"spi": {"protocol": "elkapod-2025"}, "controller": {"uart": terminal.path}})
    (found,) = results([controller.UART], CheckedRobot(settings, terminal.root, gateway_runs))
    return found


def test_a_uart_that_is_free_opens(terminal: Terminal) -> None:
    terminal.console("tty1")
    terminal.process(7, "bash) S 1 7 7 0 (", 136 << 8 | 200)
    found = looked_at(terminal)
    assert (found.verdict, found.sentence) == (
        Verdict.OK,
        f"{terminal.path} opens, as {device.node(terminal.path).user}",
    )


def test_one_that_another_program_holds(terminal: Terminal) -> None:
    other = SerialUart(terminal.path)
    found = looked_at(terminal)
    assert (found.verdict, found.sentence) == (Verdict.FAILURE, f"{terminal.path} is held by another program")
    assert looked_at(terminal, gateway_runs=True).verdict is Verdict.OK
    other.close()
    assert looked_at(terminal).verdict is Verdict.OK


def test_a_running_gateways_bytes_are_left_to_it(terminal: Terminal) -> None:
    os.write(terminal.ours, b"\x7e\xaa\n")
    assert looked_at(terminal, gateway_runs=True).verdict is Verdict.OK
    reader = os.open(terminal.path, os.O_RDONLY | os.O_NONBLOCK)
    assert os.read(reader, 16) == b"\x7e\xaa\n"
    os.close(reader)


def test_the_linux_console_on_it(terminal: Terminal) -> None:
    terminal.console(f"tty1 {Path(terminal.path).name}")
    found = looked_at(terminal)
    assert found.verdict is Verdict.FAILURE
    assert "is the Linux console" in found.sentence
    assert found.fix.startswith("sudo raspi-config nonint do_serial_cons 1 && ")


def test_a_login_on_it(terminal: Terminal) -> None:
    terminal.process(812, "agetty", terminal.number)
    found = looked_at(terminal)
    assert found.verdict is Verdict.FAILURE
    assert "is the terminal of agetty" in found.sentence
    assert "sudo raspi-config nonint do_serial_cons 1 && " in found.fix


# ---- the controller


class Bench(Uart, DuplexDevice):
    """A simulated controller on both wires, in a time of its own."""

    def __init__(self) -> None:
        self.now_ns = 10**9
        self.controller = SimulatedElkapod(clock=lambda: self.now_ns)
        self.sends: Callable[[], bytes] = self.controller.uart_read
        self.answers: Callable[[bytes], bytes] = self.controller.exchange
        self.opened = False

    def read(self) -> bytes:
        return self.sends()

    def write(self, data: bytes) -> None:
        self.controller.uart_write(data)

    def exchange(self, data: bytes) -> bytes:
        return self.answers(data)

    def pause(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)

    def device(self) -> DuplexDevice:
        self.opened = True
        return self

    def close(self) -> None:
        self.opened = False

    def found(self) -> list[Result]:
        """What is said of it."""
        talk = controller.Talk(self, self.device, 300 * MS, [0.02] * 4, lambda: self.now_ns, self.pause)
        found = list(results(controller.TALK, talk))
        assert not self.opened
        return found

    @property
    def written(self) -> list[bytes]:
        """Messages and frames, as they came."""
        both = sorted([*self.controller.messages, *self.controller.transfers])
        return [data for _, data in both]


def test_a_controller_that_answers_is_shut_down_first() -> None:
    bench = Bench()
    heartbeat, answers = bench.found()
    assert (heartbeat.verdict, heartbeat.sentence) == (
        Verdict.OK,
        "6 came in 300 ms, so the controller speaks elkapod-2025",
    )
    assert answers.verdict is Verdict.OK, "though its first answer after power-up was garbage"
    assert answers.sentence.startswith("44 of 45 are well formed, with all servos shut down: 8.")
    told, constant = answers.sentence.split("; constant all the time: ")
    assert told.endswith(" %, 25 °C, a tilt of 0 degrees")
    assert constant == "orientation, feet"
    assert bench.written[:4] == [SHUTDOWN] * 4
    assert set(bench.written[4:]) == {elkapod.frame([90_00] * 18)}
    assert not bench.controller.energised


def test_without_a_heartbeat_nothing_is_written() -> None:
    """As from a controller of v1.0.0: 80 bytes would make it deaf to Stops."""
    bench = Bench()
    bench.controller.silent = True
    (only,) = bench.found()
    assert (only.verdict, only.sentence) == (
        Verdict.FAILURE,
        "none came in 300 ms; so nothing was written to the controller",
    )
    assert 'needs spi.protocol = "hexapod-1.0"' in only.fix
    assert bench.written == []


def test_bytes_that_are_no_heartbeat() -> None:
    bench = Bench()
    bench.sends = lambda: b"login: "
    (only,) = bench.found()
    assert only.verdict is Verdict.FAILURE
    assert (
        only.sentence
        == "105 bytes came in 300 ms, and no heartbeat among them; so nothing was written to the controller"
    )
    assert bench.written == []


@pytest.mark.parametrize(
    ("garbage", "why"),
    [(bytes(80), "it goes from 00 to 00 in place of 7e to 0f"), (b"\xff" * 80, "it goes from ff to ff")],
    ids=["zeros", "FF"],
)
def test_answers_that_are_none(garbage: bytes, why: str) -> None:
    bench = Bench()
    bench.controller.garbage = garbage
    _, answers = bench.found()
    assert answers.verdict is Verdict.FAILURE
    assert answers.sentence.startswith("no well-formed answer of the controller for 300 ms")
    assert why in answers.sentence
    assert answers.sentence.endswith("0 of 45 are well formed, with all servos shut down")
    assert "MISO" in answers.fix


def test_answers_that_stay_the_same() -> None:
    bench, count = Bench(), 0

    def exchange(data: bytes) -> bytes:
        nonlocal count
        count += 1
        bench.controller.frozen = count > 3
        return bench.controller.exchange(data)

    bench.answers = exchange
    _, answers = bench.found()
    assert answers.verdict is Verdict.FAILURE
    assert "it has not changed for 500 ms" in answers.sentence


def test_a_robot_whose_inertial_sensor_is_missing_is_well_but_for_that() -> None:
    bench = Bench()
    bench.exchange(bytes(80))
    bench.controller.frozen = True
    _, answers = bench.found()
    assert answers.verdict is Verdict.WARNING
    assert answers.sentence.endswith("constant all the time: " + ", ".join(dict.fromkeys(VALUE_NAMES)))
    assert answers.fix.startswith("see that the inertial sensor is connected")


def test_heartbeats_that_end_once_frames_come() -> None:
    bench = Bench()

    def exchange(data: bytes) -> bytes:
        bench.controller.silent = True
        return bench.controller.exchange(data)

    bench.answers = exchange
    _, answers = bench.found()
    assert answers.verdict is Verdict.FAILURE
    assert answers.sentence.startswith("no heartbeat of the controller for 300 ms")


def test_some_answers_that_are_none_are_a_warning() -> None:
    bench = Bench()
    count = 0

    def exchange(data: bytes) -> bytes:
        nonlocal count
        count += 1
        answer = bench.controller.exchange(data)
        return bytes(80) if 10 <= count < 12 else answer

    bench.answers = exchange
    _, answers = bench.found()
    assert (answers.verdict, answers.sentence) == (
        Verdict.WARNING,
        "42 of 45 are well formed, with all servos shut down",
    )
