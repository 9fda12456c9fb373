"""The steps of `check --stops` for a power board: what it confirms, and one of its two ways unplugged."""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from gateway.onboard.check import stops
from schemas import keys
from schemas.telemetry import GatewayState
from tests.benchmarks.processes import never_delay
from tests.support.command import Ended
from tests.support.fixtures import patient
from tests.support.gateway_process import Gateway
from tests.support.heard import Heard

pytestmark = pytest.mark.full

LATE_MS = 2000
"""For a machine that is busy with other tests."""


class Robot:
    """A gateway with a power board, simulated in a process of its own, and a person who plugs and unplugs."""

    def __init__(self, folder: Path, **settings: Any) -> None:
        self._record = folder / "record"
        argument = json.dumps({"record": str(self._record)})
        command = [sys.executable, "-m", "gateway.simulation.board_port", argument]
        self._board = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._board.stdout is not None
        channel = self._board.stdout.readline().strip()
        never_delay(self._board.pid)  # it stands for hardware, which no load slows
        board = {"interface": "slcan", "channel": channel, "confirm_ms": 500, **settings}
        self.gateway = Gateway(folder, patient(1000, telemetry={"frames": True}, power=board))

    @property
    def fed(self) -> int:
        """The mask of what the board feeds."""
        changes = [line.split() for line in self._record.read_text().splitlines() if " = " in line]
        return int(changes[-1][2], 16) if changes else 0

    def silent(self, silent: bool) -> None:
        """No frame passes between board and adapter."""
        assert self._board.stdin is not None
        self._board.stdin.write(json.dumps({"silent": silent}) + "\n")
        self._board.stdin.flush()

    def close(self) -> None:
        self._board.communicate()

    def check(self, step: str) -> Ended:
        return self.gateway.run("check", "--stops", "--unplug", "--late", str(LATE_MS), "--only", step)


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Robot]]:
    monkeypatch.setattr(stops, "_ANSWER_MS", LATE_MS)
    with ExitStack() as stack:

        def made(**settings: Any) -> Robot:
            robot = Robot(tmp_path, **settings)
            stack.callback(robot.close)
            client = stack.enter_context(stack.enter_context(robot.gateway).client())
            Heard(client, keys.STATE, GatewayState).wait(lambda _: stops.is_at_rest(client))
            return robot

        yield made


@pytest.fixture
def person(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[str], str]], None]:
    """Somebody is at the simulated robot, and does this when asked."""

    def does(answer: Callable[[str], str]) -> None:
        monkeypatch.setattr(stops, "by_hand", stops.board)
        for name in ("ask", "hint"):
            monkeypatch.setattr(stops, name, answer)

    return does


def test_the_board_confirms_an_emergency_stop(robot: Callable[..., Robot]) -> None:
    done = robot().check("power")
    assert done.returncode == 0, str(done)
    assert "PASS     power          confirmed_after_ms " in done.stdout


def test_without_a_board_and_without_a_person_there_is_nothing_to_show(robot: Callable[..., Robot]) -> None:
    found = robot()
    for step in ("spi-unplugged", "can-unplugged"):
        assert "SKIPPED" in found.check(step).stdout
    assert "SKIPPED" in found.gateway.run("check", "--stops", "--only", "can-unplugged").stdout


@pytest.mark.parametrize(("loose", "code"), [("yes", 0), ("no", 1)])
def test_spi_unplugged(
    robot: Callable[..., Robot],
    person: Callable[[Callable[[str], str]], None],
    loose: str,
    code: int,
) -> None:
    """The supply comes back only once the controller has its Stops."""
    found = robot()
    fed_when: dict[str, int] = {}

    def answer(question: str) -> str:
        word = question.split(maxsplit=1)[0]
        end_s = time.monotonic() + 20
        while word == "Unplug" and not found.fed and time.monotonic() < end_s:
            time.sleep(0.01)  # the board's process writes it down a moment later
        fed_when[word] = found.fed
        return loose

    person(answer)
    done = found.check("spi-unplugged")
    assert done.returncode == code, str(done)
    assert fed_when["Unplug"]
    assert fed_when["Turn"] == fed_when["Plug"] == 0


def test_can_unplugged(robot: Callable[..., Robot], person: Callable[[Callable[[str], str]], None]) -> None:
    found = robot()

    def answer(question: str) -> str:
        found.silent(question.startswith("Unplug"))
        return ""

    person(answer)
    done = found.check("can-unplugged")
    assert done.returncode == 0, str(done)
    assert "silent_when_reported_ms" in done.stdout
