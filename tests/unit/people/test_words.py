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


def partly(*partly: int) -> GatewayState:
    """All legs run, but of these one servo only."""
    found = of(ALL)
    legs = [
        leg.model_copy(update={"servos": tuple(servo(each.id, each is leg.servos[0]) for each in leg.servos)})
        if leg.leg in partly
        else leg
        for leg in found.legs
    ]
    return found.model_copy(update={"legs": tuple(legs)})


ESTOPPED = of((), Mode.ESTOPPED, estop_source="anna")
BY_ANNA = "Emergency stop by anna: nothing runs until a reset"
SILENT = ControllerReport(alive=False)


@pytest.mark.parametrize(
    ("found", "driver", "sentence"),
    [
        (of(()), None, "No servo runs"),
        (of((1, 3, 4)), None, "Legs 1, 3 and 4 run"),
        (of(ALL), None, "All six legs run"),
        (of(()), walk(Posture.LYING), "It lies"),
        (of(ALL), walk(Posture.SITTING), "It sits"),
        (of(ALL), walk(Posture.STANDING), "It stands"),
        (of(ALL), walk(Posture.WALKING), "It walks"),
        (of(ALL), walk(Posture.MOVING), "It moves to another posture"),
        (of(ALL - {3}), walk(Posture.HALTED, 3), "Leg 3 is stopped, and the others stand still"),
        # its driver does not know yet, or holds them no more
        (of(ALL - {3, 4}), walk(Posture.HALTED, 3), "Legs 3 and 4 are stopped, and the others run"),
        (of(ALL - {3}), walk(Posture.WALKING), "Leg 3 is stopped, and the others run"),
        (of(ALL), walk(Posture.HALTED), "All six legs run"),
        # limp, whatever was lost first, and whatever was wanted
        (of(()), walk(Posture.HALTED, 3), LIMP),
        (of(()), walk(Posture.WALKING), LIMP),
        # one servo of a leg is no leg that stands
        (partly(*LEGS), walk(Posture.STANDING), "All six legs run"),
        (partly(1), walk(Posture.HALTED, 1), "Leg 1 is stopped, and the others stand still"),
        # an emergency stop holds until the reset and no longer
        *((ESTOPPED, driver, BY_ANNA) for driver in (None, walk(Posture.HALTED, 3), walk(Posture.WALKING))),
        (of((), Mode.ESTOPPED), walk(Posture.WALKING), "Emergency stop: nothing runs until a reset"),
        (of((), Mode.IDLE, estop_source="anna"), None, "No servo runs"),
        # a controller that fell silent, and what the gateway knows without a bus fault
        (of(ALL, Mode.BUS_FAULT, controller=SILENT), None, "The controller is silent: what was written may not have "
         "arrived"),
        (of(ALL, controller=SILENT), None, "All six legs run"),
    ],
)  # fmt: skip
def test_what_runs_decides_and_the_posture_only_names_it(
    found: GatewayState, driver: WalkState | None, sentence: str
) -> None:
    assert robot_now(found, NEWS_S, driver) == sentence


def test_an_older_state_that_comes_later_changes_nothing_and_a_gateway_that_began_anew_does() -> None:
    newest, driver = Newest(), walk(Posture.STANDING)
    assert "no state yet" in newest.sentence(0.0, driver)
    newest.take(of(ALL, uptime_s=10.0), 100.0)
    newest.take(of((), uptime_s=9.9), 100.1)
    assert newest.sentence(100.9, driver) == "It stands"
    assert "is 2 s old" in newest.sentence(102.0, driver)
    newest.take(of((), uptime_s=10.0 - NEWS_S), 102.0)
    assert newest.sentence(102.0, driver) == LIMP


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
