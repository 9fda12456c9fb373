"""What the robot does now, in a sentence for each situation: what is shown is so, whatever its driver had wanted."""

from collections.abc import Collection
from typing import Any

import pytest

from gateway.people.walking.motion import STILL, Odometry, Posture, WalkState
from gateway.people.walking.words import NEWS_S, Newest, ground_now, robot_now
from schemas.robot import LEGS
from schemas.telemetry import ControllerReport, GatewayState, Mode
from tests.support.published import servo, state

ALL = frozenset(LEGS)
LIMP = "All six legs are stopped, and hold no weight"


def of(running: Collection[int], mode: Mode = Mode.ACTIVE, **changed: object) -> GatewayState:
    """The gateway's state while exactly these legs run."""
    return state(mode=mode, running=running).model_copy(update=changed)


def walk(posture: Posture, *lost: int) -> WalkState:
    return WalkState(posture, "tripod", 0.15, STILL, STILL, "", Odometry(0.0, 0.0, 0.0), lost)


@pytest.mark.parametrize(
    ("running", "driver", "sentence"),
    [
        ((), None, "No servo runs"),
        ((1, 3, 4), None, "Legs 1, 3 and 4 run"),
        (ALL, None, "All six legs run"),
        ((), walk(Posture.LYING), "It lies"),
        (ALL, walk(Posture.SITTING), "It sits"),
        (ALL, walk(Posture.STANDING), "It stands"),
        (ALL, walk(Posture.WALKING), "It walks"),
        (ALL, walk(Posture.MOVING), "It moves to another posture"),
        (ALL - {3}, walk(Posture.HALTED, 3), "Leg 3 is stopped, and the others stand still"),
        # its driver does not know yet, or holds them no more
        (ALL - {3, 4}, walk(Posture.HALTED, 3), "Legs 3 and 4 are stopped, and the others run"),
        (ALL - {3}, walk(Posture.WALKING), "Leg 3 is stopped, and the others run"),
        (ALL, walk(Posture.HALTED), "All six legs run"),
        # limp, whatever was lost first, and whatever was wanted
        ((), walk(Posture.HALTED, 3), LIMP),
        ((), walk(Posture.WALKING), LIMP),
    ],
)
def test_what_runs_decides_and_the_posture_only_names_it(
    running: Collection[int], driver: WalkState | None, sentence: str
) -> None:
    assert robot_now(of(running), NEWS_S, driver) == sentence


@pytest.mark.parametrize("driver", [None, walk(Posture.HALTED, 3), walk(Posture.WALKING)])
def test_an_emergency_stop_holds_until_the_reset_and_no_longer(driver: WalkState | None) -> None:
    during = of((), Mode.ESTOPPED, estop_source="anna")
    assert robot_now(during, walk=driver) == "Emergency stop by anna: nothing runs until a reset"
    assert robot_now(of((), Mode.ESTOPPED), walk=driver) == "Emergency stop: nothing runs until a reset"
    assert "reset" not in robot_now(of((), Mode.IDLE, estop_source="anna"), walk=driver)


def test_a_bus_fault_of_a_controller_that_fell_silent_names_it() -> None:
    silent = ControllerReport(alive=False)
    fault = of(ALL, Mode.BUS_FAULT, controller=silent)
    assert robot_now(fault) == "The controller is silent: what was written may not have arrived"
    assert robot_now(of(ALL, controller=silent)) == "All six legs run", "as far as the gateway knows"


def test_an_older_state_that_comes_later_changes_nothing_and_a_gateway_that_began_anew_does() -> None:
    newest, driver = Newest(), walk(Posture.STANDING)
    assert "no state yet" in newest.sentence(0.0, driver)
    newest.take(of(ALL, uptime_s=10.0), 100.0)
    newest.take(of((), uptime_s=9.9), 100.1)
    assert newest.sentence(100.9, driver) == "It stands"
    assert "is 2 s old" in newest.sentence(102.0, driver)
    newest.take(of((), uptime_s=10.0 - NEWS_S), 102.0)
    assert newest.sentence(102.0, driver) == LIMP


def test_one_servo_of_each_leg_is_no_leg_that_stands() -> None:
    found = of(ALL)
    legs = [
        leg.model_copy(update={"servos": (leg.servos[0], *(servo(each.id, False) for each in leg.servos[1:]))})
        for leg in found.legs
    ]
    partly = found.model_copy(update={"legs": tuple(legs)})
    assert robot_now(partly, walk=walk(Posture.STANDING)) == "All six legs run"
    one = found.model_copy(update={"legs": (legs[0], *found.legs[1:])})
    assert robot_now(one, walk=walk(Posture.HALTED, 1)) == "Leg 1 is stopped, and the others stand still"


@pytest.mark.parametrize(
    ("felt", "sentence"),
    [
        ({"terrain": "level", "tilt_deg": 3.0}, ""),
        ({}, "No sensors: it walks as on a level floor"),
        ({"tilt_deg": 3.14, "corrected_deg": 6.0}, "Leans by 3.1°, 6.0° corrected"),
        (
            {"tilt_deg": 3.14, "carrying": (True, False, False, True, True, False), "hanging": (2,)},
            "Leans by 3.1°, 0.0° corrected; legs 1, 4 and 5 carry; leg 2 hangs over an edge",
        ),
        ({"carrying": (False,) * 6, "hanging": (2, 6)}, "No leg carries; legs 2 and 6 hang over an edge"),
        ({"carrying": (True, *(False,) * 5)}, "Leg 1 carries"),
    ],
)
def test_what_a_walk_by_sensors_feels_is_one_sentence(felt: dict[str, Any], sentence: str) -> None:
    assert ground_now(walk(Posture.WALKING)._replace(**{"terrain": "adapt", **felt})) == sentence
