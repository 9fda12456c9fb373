"""`check` on a UART and a power board, and what `--move` says of the board's currents."""

import datetime as dt
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gateway.onboard.check import wire
from gateway.onboard.check.move import output
from gateway.onboard.check.table import CheckedRobot, Result, results
from gateway.robot.settings import Settings
from schemas.telemetry import ServoTelemetry, Telemetry
from tests.support.machine_tree import MachineTree
from tests.support.slcan_adapter import Adapter

BYTES = b"\x7e\xaa\n"


# ---- the UART of elkapod-2025


class Terminal:
    """A pseudo terminal in place of a UART, on which something has been sent, and the /proc and /sys of its machine."""

    def __init__(self, root: Path) -> None:
        self.ours, self._theirs = os.openpty()
        os.write(self.ours, BYTES)
        self.path = os.ttyname(self._theirs)
        settings = Settings.of({"wire": {"name": "elkapod-2025"}, "controller": {"uart": self.path}})
        self.units: dict[str, dict[str, str]] = {}
        self.robot = CheckedRobot(settings, root, lambda unit: self.units.get(unit, {}))
        MachineTree(root)

    def console(self, names: str) -> None:
        folder = self.robot.root / "sys/class/tty/console"
        folder.mkdir(parents=True)
        (folder / "active").write_text(f"{names}\n")

    def login(self) -> None:
        self.units[f"serial-getty@{Path(self.path).name}.service"] = {"ActiveState": "active"}

    def unread(self) -> bytes:
        reader = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK)
        try:
            return os.read(reader, 16)
        finally:
            os.close(reader)

    def close(self) -> None:
        os.close(self.ours)
        os.close(self._theirs)


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    made = Terminal(tmp_path)
    yield made
    made.close()


@pytest.mark.parametrize(
    ("plant", "verdict", "says"),
    [
        (lambda _: None, "ok", " opens"),
        (lambda each: each.console("tty1"), "ok", " opens"),
        (lambda each: setattr(each.robot, "gateway_runs", True), "ok", "is the running gateway's"),
        (lambda each: each.console(f"tty1 {Path(each.path).name}"), "failure", "console or a login"),
        (Terminal.login, "failure", "console or a login"),
    ],
)
def test_a_uart(terminal: Terminal, plant: Callable[[Terminal], None], verdict: str, says: str) -> None:
    """What a gateway will read, or nobody may, is left there."""
    plant(terminal)
    (found,) = results(terminal.robot, wire.uart)
    assert (found.verdict, says in found.sentence) == (verdict, True), found
    if verdict != "ok" or terminal.robot.gateway_runs:
        assert terminal.unread() == BYTES


# ---- the power board


@pytest.fixture
def adapter(tmp_path: Path) -> Iterator[Adapter]:
    made = Adapter(str(tmp_path / "adapter"))
    yield made
    made.unplug()


def board(tmp_path: Path, *, gateway_runs: bool = False) -> Result:
    settings = Settings.of({"power": {"interface": "slcan", "channel": str(tmp_path / "adapter")}})
    (found,) = results(CheckedRobot(settings, gateway_runs=gateway_runs), wire.power)
    return found


def test_a_board_that_is_the_gateways_or_not_for_this_user_is_not_opened(
    adapter: Adapter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert board(tmp_path, gateway_runs=True).verdict == "ok"
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "can", None)
        assert "python-can is not installed" in board(tmp_path).sentence
    with monkeypatch.context() as patch:
        patch.setattr(os, "access", lambda *_: False)
        assert "may not be opened" in board(tmp_path).sentence
    assert adapter.received == []
    assert "whether the board answers" in board(tmp_path).sentence, "and is opened"


# ---- currents


@pytest.mark.parametrize(
    ("moving", "says"),
    [
        ({"11": 0.009, "12": 0.008, "61": 0.4}, "output for servo 61 feeds it (392 mA"),
        ({"11": 0.009, "12": 0.4, "61": 0.008}, "feeds another servo, or none"),
        ({"61": 0.04}, "has measured no current of servo 61"),
        ({}, "has measured no current of servo 61"),
    ],
)
def test_the_highest_currents_show_which_output_feeds_a_servo(moving: dict[str, float], says: str) -> None:
    def report(amperes: dict[str, float | None]) -> Telemetry:
        servos = {name: ServoTelemetry(supplied=True, current_a=each) for name, each in amperes.items()}
        return Telemetry(time=dt.datetime.now(dt.UTC), age_ms=0, servos=servos)

    rest = [report({"11": 0.008, "12": 0.008, "61": 0.008}), report({"61": 0.003, "12": None})]
    assert says in output(rest, [report(dict(moving)), report(dict.fromkeys(moving, 0.001))], 61)
