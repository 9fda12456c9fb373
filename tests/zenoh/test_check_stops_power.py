"""The steps of `check --stops` for a power board: what it confirms, and one of its two ways unplugged."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gateway.onboard.check import stops
from schemas import keys
from schemas.telemetry import GatewayState
from tests.support.command import Ended
from tests.support.fixtures import patient
from tests.support.gateway_process import Gateway
from tests.support.heard import Heard
from tests.support.recorded_board import RecordedBoard

pytestmark = pytest.mark.full

LATE_MS = 2000
"""For a machine that is busy with other tests."""


class Robot:
    """A gateway with a power board, and a person who plugs and unplugs."""

    def __init__(self, folder: Path, board: RecordedBoard) -> None:
        self.board = board
        power = {**board.settings, "confirm_ms": 500}
        self.gateway = Gateway(folder, patient(1000, telemetry={"frames": True}, power=power))

    @property
    def fed(self) -> int:
        """The mask of what the board feeds."""
        return next((each.mask for each in reversed(self.board.noted) if each.what == "fed"), 0)

    def check(self, step: str) -> Ended:
        return self.gateway.run("check", "--stops", "--unplug", "--late", str(LATE_MS), "--only", step)


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Robot]:
    monkeypatch.setattr(stops, "_ANSWER_MS", LATE_MS)
    with RecordedBoard(tmp_path) as board:
        made = Robot(tmp_path, board)
        with made.gateway, made.gateway.client() as client:
            Heard(client, keys.STATE, GatewayState).wait(lambda _: stops.is_at_rest(client))
            yield made


@pytest.fixture
def person(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[str], str]], None]:
    """Somebody is at the simulated robot, and does this when asked."""

    def does(answer: Callable[[str], str]) -> None:
        monkeypatch.setattr(stops, "by_hand", stops.board)
        for name in ("ask", "hint"):
            monkeypatch.setattr(stops, name, answer)

    return does


def test_the_board_confirms_an_emergency_stop(robot: Robot) -> None:
    done = robot.check("power")
    assert done.returncode == 0, str(done)
    assert "PASS     power          confirmed_after_ms " in done.stdout


def test_without_a_board_and_without_a_person_there_is_nothing_to_show(robot: Robot) -> None:
    for step in ("spi-unplugged", "can-unplugged"):
        assert "SKIPPED" in robot.check(step).stdout
    assert "SKIPPED" in robot.gateway.run("check", "--stops", "--only", "can-unplugged").stdout


@pytest.mark.parametrize(("loose", "code"), [("yes", 0), ("no", 1)])
def test_spi_unplugged(
    robot: Robot,
    person: Callable[[Callable[[str], str]], None],
    loose: str,
    code: int,
) -> None:
    """The supply comes back only once the controller has its Stops."""
    fed_when: dict[str, int] = {}

    def answer(question: str) -> str:
        word = question.split(maxsplit=1)[0]
        end_s = time.monotonic() + 20
        while word == "Unplug" and not robot.fed and time.monotonic() < end_s:
            time.sleep(0.01)  # the board's process writes it down a moment later
        fed_when[word] = robot.fed
        return loose

    person(answer)
    done = robot.check("spi-unplugged")
    assert done.returncode == code, str(done)
    assert fed_when["Unplug"]
    assert fed_when["Turn"] == fed_when["Plug"] == 0


def test_can_unplugged(robot: Robot, person: Callable[[Callable[[str], str]], None]) -> None:

    def answer(question: str) -> str:
        robot.board.disturb(silent=question.startswith("Unplug"))
        return ""

    person(answer)
    done = robot.check("can-unplugged")
    assert done.returncode == 0, str(done)
    assert "silent_when_reported_ms" in done.stdout
