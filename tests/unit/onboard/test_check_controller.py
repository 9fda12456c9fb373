"""What `check` says of a controller of elkapod-2025: its UART, and its heartbeat."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.onboard.check import wire
from gateway.onboard.check.table import CheckedRobot, Result, Verdict, judged, results
from gateway.robot.settings import Settings
from gateway.robot.spi.elkapod_simulator import SimulatedElkapod
from gateway.robot.spi.uart import SerialUart
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
    (found,) = results([wire.CONTROLLER[0]], CheckedRobot(settings, terminal.root, gateway_runs))
    return found


def test_a_uart_that_is_free_opens(terminal: Terminal) -> None:
    terminal.console("tty1")
    terminal.process(7, "bash) S 1 7 7 0 (", 136 << 8 | 200)
    found = looked_at(terminal)
    assert (found.verdict, found.sentence) == (
        Verdict.OK,
        f"{terminal.path} opens, as {wire.node(terminal.path).user}",
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
    assert found.fix == "free it, and reboot: sudo hexapod-gateway setup --wire elkapod-2025"


def test_a_login_on_it(terminal: Terminal) -> None:
    terminal.process(812, "agetty", terminal.number)
    found = looked_at(terminal)
    assert found.verdict is Verdict.FAILURE
    assert "is the terminal of agetty" in found.sentence
    assert "sudo hexapod-gateway setup --wire elkapod-2025" in found.fix


# ---- the controller


@pytest.mark.parametrize(
    ("sends", "beats", "sentence"),
    [
        (None, 6, "6 came in 300 ms, so the controller speaks elkapod-2025"),
        (b"", 0, "none came in 300 ms, but 0 other bytes"),
        (b"login: ", 0, "none came in 300 ms, but 105 other bytes"),
    ],
    ids=["a controller", "silence", "a login"],
)
def test_its_heartbeat_is_awaited(sends: bytes | None, beats: int, sentence: str) -> None:
    """Nothing can be written by what only reads: 80 bytes would make a controller of v1.0.0 deaf to Stops."""
    now_ns = 10**9

    def pause(seconds: float) -> None:
        nonlocal now_ns
        now_ns += round(seconds * 1e9)

    simulated = SimulatedElkapod(clock=lambda: now_ns)
    read = simulated.uart_read if sends is None else lambda: sends
    seen = wire.heartbeat(read, 300 * MS, lambda: now_ns, pause)
    (found,) = judged(wire.CONTROLLER[1], seen)
    assert (seen.beats, found.sentence) == (beats, sentence)
    assert found.verdict is (Verdict.OK if beats else Verdict.FAILURE)


def test_a_uart_with_a_fault_of_its_own_is_not_listened_to(terminal: Terminal) -> None:
    terminal.console(Path(terminal.path).name)
    os.write(terminal.ours, b"\x7e\xaa\n")
    settings = Settings.model_validate({"spi": {"protocol": "elkapod-2025"}, "controller": {"uart": terminal.path}})
    assert list(results(wire.CONTROLLER[1:], CheckedRobot(settings, terminal.root))) == []
    reader = os.open(terminal.path, os.O_RDONLY | os.O_NONBLOCK)
    assert os.read(reader, 16) == b"\x7e\xaa\n"
    os.close(reader)
