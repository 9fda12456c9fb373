"""An emergency stop that an earlier run has left: it is engaged, and until that is known, one counts as engaged."""

import pytest

from gateway.robot.core.events import EstopKept
from gateway.robot.core.leg import Rules
from gateway.robot.core.message import Verb
from schemas import keys
from tests.support.robot import started_and_quiet
from tests.support.scenes import Scenes, leg_to

KEPT = Rules(repeats=0, rest_runs=0, estop_kept=True)


def test_until_it_is_known_one_counts_as_engaged_and_no_reset_leaves_it() -> None:
    robot = Scenes(KEPT)
    assert robot.supervisor.mode == "estopped"
    assert robot.command(1, leg_to(1, "start 90")) == ["rejected 1 estopped"]
    assert robot.do(3000, "reset") == ["rejected 2 estopped"]
    assert robot.take(3001, EstopKept(0, engaged=False)) == []
    assert robot.supervisor.mode == "idle"
    assert robot.command(3002, leg_to(1, "start 90")) == ["command 1 start 90", "completed 3"]


def test_numbers_go_on_so_a_reset_of_an_earlier_run_leaves_no_emergency_stop_of_this_one() -> None:
    robot = Scenes(KEPT)
    robot.take(1, EstopKept(7, engaged=False))
    robot.do(2, "estop")
    assert robot.supervisor.latch.number == 8
    assert robot.do(3, "reset -1") == ["rejected 1 estopped"]


# ---- which events are announced, and when


@pytest.mark.virtual_time
@pytest.mark.parametrize("verb", [Verb.PUT, Verb.GET])
async def test_it_is_told_behind_the_stops_of_each_emergency_stop_and_at_its_reset(verb: Verb) -> None:
    robot = await started_and_quiet()
    told: list[tuple[int, bool, int, str | None]] = []

    def note() -> None:
        latch = robot.conductor.supervisor.latch
        told.append((latch.number, latch.since_ns is not None, len(robot.frames), robot.conductor.reports.estop_source))

    robot.conductor.on_latch = note
    for source in ("anna", "bert"):
        robot.controller.transfers.clear()
        robot.put(keys.ESTOP, {"source": source}, verb=verb)
    since = robot.state().estop_since
    assert since is not None
    robot.put(keys.RESET, {"estop": 2})
    assert told == [(1, True, 6, "anna"), (2, True, 6, "bert"), (2, False, 6, "bert")]
    assert robot.state().estop_since is None
