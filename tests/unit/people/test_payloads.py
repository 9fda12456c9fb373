"""The values that a program may pass for legs, servos and angles, and the errors for others."""

import json
import math
import re
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from gateway.errors import OutOfRangeError, WalkError
from gateway.people.client.payloads import leg_number, leg_payload, legs_angles, legs_payload, number, servo_number
from gateway.people.walking.gait_speed import Distance
from gateway.people.walking.motion import Velocity
from schemas.telemetry import Reason


class Whole:
    """A number that is an integer only."""

    def __index__(self) -> int:
        return 90


@pytest.mark.parametrize(
    ("given", "sent"),
    [
        (180.005, 180.0),
        (-0.005, 0.0),
        (Decimal("180.001"), 180.0),
        (90.123, 90.123),
        (np.float32(45.5), 45.5),
        (Whole(), 90),
    ],
)
def test_what_is_outside_by_arithmetic_only_is_the_limit(given: Any, sent: float) -> None:
    assert number(given) == sent


@pytest.mark.parametrize("wrong", [180.0051, -0.0051, 200, math.nan, math.inf])
def test_an_angle_that_no_servo_has_names_leg_and_joint(wrong: float) -> None:
    with pytest.raises(OutOfRangeError, match=f"leg 4, joint 3: {wrong:g}° is not between 0 and 180°$") as error:
        legs_payload("set", {3: (90, 45, 120), 4: (90, 45, wrong)})
    assert (error.value.reason, isinstance(error.value, ValueError)) == (Reason.INVALID, True)


ROWS = [(10.0 * leg, 10.0 * leg + 1, 10.0 * leg + 2) for leg in range(6)]


@pytest.mark.parametrize(
    "all_legs",
    [
        np.array(ROWS),
        np.array(ROWS).reshape(18),
        np.array(ROWS, dtype=np.float32),
        ROWS,
        [angle for row in ROWS for angle in row],
        {np.int64(leg): np.array(row) for leg, row in enumerate(ROWS, start=1)},
    ],
    ids=["6×3", "18", "float32", "lists", "a list", "a dict of arrays"],
)
def test_all_legs_may_be_an_array(all_legs: Any) -> None:
    assert legs_angles(all_legs) == dict(enumerate(ROWS, start=1))
    assert json.loads(json.dumps(legs_payload("set", all_legs))) == legs_payload("set", dict(enumerate(ROWS, start=1)))


def test_radians_are_a_unit() -> None:
    assert legs_angles(np.full((6, 3), np.pi / 2), "rad") == dict.fromkeys(range(1, 7), (90.0,) * 3)
    assert leg_payload("set", (0, 1, math.pi), "rad")["servos"][1]["angle_deg"] == pytest.approx(57.29578)
    with pytest.raises(OutOfRangeError, match=r"joint 2: 229\.183° is not between 0 and 180°"):
        leg_payload("set", (0, 4, 1), "rad")
    with pytest.raises(ValueError, match='the unit of angles is "deg" or "rad", and not \'grad\''):
        leg_payload("set", (0, 4, 1), "grad")  # type: ignore[arg-type]


SHAPES = [(3, 6), (6, 2), (17,), (1, 18), (18, 1), (2, 3, 3), (0,), (6,)]
SHAPE = "an array for all six legs has the shape (6, 3) or (18,), not "
DICT = "legs and their angles are a dict, such as {3: (90, 45, 120)}, or an array"
NO_ORDER = [{90, 45, 120}, {1: 90, 2: 45, 3: 120}, "abc", b"abc", 90, None]
ORDER = "a leg's angles are a list, a tuple or an array of three"


@pytest.mark.parametrize(
    ("call", "wrong", "error", "sentence"),
    [
        *((legs_angles, np.zeros(shape), OutOfRangeError, SHAPE) for shape in SHAPES),
        *((legs_angles, wrong, TypeError, DICT) for wrong in ({1, 2}, "abc", 90, None)),
        *((legs_angles, {3: wrong}, TypeError, ORDER) for wrong in NO_ORDER),
        (legs_angles, {3: (1, 2)}, OutOfRangeError, "2 angles; a leg has three joints"),
        *((number, wrong, TypeError, f"a number of degrees, and not {wrong!r}") for wrong in ([90], True, "90", None)),
        (leg_number, "3", TypeError, "a leg is a whole number, and not '3'; legs are 1 to 6"),
        (leg_number, 3.0, TypeError, "a leg is a whole number, and not 3.0; legs are 1 to 6"),
        (leg_number, True, TypeError, "a leg is a whole number, and not True; legs are 1 to 6"),
        (leg_number, 7, OutOfRangeError, "leg 7 does not exist; legs are 1 to 6"),
        (servo_number, "32", TypeError, "a servo is a whole number, and not '32'; an id is the leg"),
        (servo_number, 14, OutOfRangeError, "servo 14 does not exist; an id is the leg"),
    ],
)
def test_what_is_no_angle_leg_or_servo_is_reported(
    call: Callable[[Any], object], wrong: object, error: type[Exception], sentence: str
) -> None:
    with pytest.raises(error, match=re.escape(sentence)):
        call(wrong)


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.int64, np.array, int, Fraction])
def test_every_number_is_a_velocity_and_a_distance(kind: Callable[[float], Any]) -> None:
    assert Velocity.checked(kind(1), kind(0), kind(-1)) == (1.0, 0.0, -1.0)
    assert Distance(kind(1), turns=False)
    assert number(kind(1)) == 1.0


@pytest.mark.parametrize("value", [True, np.True_, np.array(True), "1", None, np.array([1.0, 2.0])])
def test_a_bool_a_text_and_several_are_no_number(value: Any) -> None:
    with pytest.raises(WalkError, match="a velocity is a finite number"):
        Velocity.checked(value, 0, 0)
    with pytest.raises(WalkError, match="a distance is a finite number"):
        Distance(value, turns=True)
    with pytest.raises(TypeError, match="an angle is a number"):
        number(value)
