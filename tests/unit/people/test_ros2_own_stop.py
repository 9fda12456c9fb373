"""Which emergency stop ROS may leave: its own, and only where nobody else can have engaged one."""

from collections.abc import Callable

import pytest

from gateway.people.ros2.own_stop import OwnStop
from schemas.telemetry import GatewayState
from tests.support.published import state as published


def state(estop: int, uptime_s: float = 100.0) -> GatewayState:
    return published(uptime_s=uptime_s).model_copy(update={"estop": estop})


def ros(number: int | None, *, drove: bool = True) -> Callable[[OwnStop], None]:
    return lambda own: own.engaged(number, drove=drove)


CASES: dict[str, tuple[list[Callable[[OwnStop], None]], int, bool]] = {
    "its own": ([ros(5)], 5, True),
    "its own, again, after the driving has ended": ([ros(5), ros(6, drove=False)], 6, True),
    "its own, and then a person's": ([ros(5)], 6, False),
    "a person's, and then its own": ([ros(6)], 6, False),
    "its own, a person's, its own": ([ros(5), ros(7, drove=False)], 7, False),
    "not while it drove": ([ros(5, drove=False)], 5, False),
    "without an answer": ([ros(None)], 5, False),
    "without an answer, and then with one": ([ros(None), ros(6)], 6, False),
    "released": ([ros(5), OwnStop.forget], 5, False),
    "none was engaged through ROS": ([], 4, False),
}


@pytest.mark.parametrize("case", CASES)
def test_only_its_own(case: str) -> None:
    happened, latest, may = CASES[case]
    own = OwnStop()
    own.drives(state(4), now_s=1000.0)
    for each in happened:
        each(own)
    assert own.may_leave(state(latest, uptime_s=130.0), now_s=1030.0) == (latest if may else None)


def test_a_gateway_that_was_started_again_counts_anew() -> None:
    own = OwnStop()
    own.drives(state(0, uptime_s=100.0), now_s=1000.0)
    own.engaged(1, drove=True)
    assert own.may_leave(state(1, uptime_s=110.0), now_s=1010.0) == 1
    assert own.may_leave(state(1, uptime_s=200.0), now_s=2000.0) is None


@pytest.mark.parametrize(("late_s", "may"), [(-1.0, True), (1.0, True), (1.25, False), (-1.25, False)])
def test_an_answer_may_be_a_second_late(late_s: float, may: bool) -> None:
    own = OwnStop()
    own.drives(state(0), now_s=1000.0)
    own.engaged(1, drove=True)
    assert own.may_leave(state(1, uptime_s=130.0), now_s=1030.0 + late_s) == (1 if may else None)


def test_a_new_drive_begins_anew() -> None:
    own = OwnStop()
    own.drives(state(4), now_s=1000.0)
    own.engaged(5, drove=True)
    own.drives(state(5), now_s=1000.0)
    assert own.may_leave(state(5), now_s=1000.0) is None
