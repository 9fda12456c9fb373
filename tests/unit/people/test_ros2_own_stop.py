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


CASES: dict[str, tuple[list[Callable[[OwnStop], None]], int, float, bool]] = {
    "its own": ([ros(5)], 5, 0, True),
    "its own, again, after the driving has ended": ([ros(5), ros(6, drove=False)], 6, 0, True),
    "its own, and then a person's": ([ros(5)], 6, 0, False),
    "a person's, and then its own": ([ros(6)], 6, 0, False),
    "its own, a person's, its own": ([ros(5), ros(7, drove=False)], 7, 0, False),
    "not while it drove": ([ros(5, drove=False)], 5, 0, False),
    "without an answer": ([ros(None)], 5, 0, False),
    "without an answer, and then with one": ([ros(None), ros(6)], 6, 0, False),
    "released": ([ros(5), OwnStop.forget], 5, 0, False),
    "none was engaged through ROS": ([], 4, 0, False),
    "before a new drive": ([ros(5), lambda own: own.drives(state(5), now_s=1000.0)], 5, 0, False),
    "a second late": ([ros(5)], 5, 1.0, True),
    "a second early": ([ros(5)], 5, -1.0, True),
    "later": ([ros(5)], 5, 1.25, False),
    "earlier": ([ros(5)], 5, -1.25, False),
}
"""What happened, the latest emergency stop, how late a state comes by its uptime, and whether ROS may leave it."""


@pytest.mark.parametrize("case", CASES)
def test_only_its_own(case: str) -> None:
    happened, latest, late_s, may = CASES[case]
    own = OwnStop()
    own.drives(state(4), now_s=1000.0)
    for each in happened:
        each(own)
    assert own.may_leave(state(latest, uptime_s=130.0), now_s=1030.0 + late_s) == (latest if may else None)
