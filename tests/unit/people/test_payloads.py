"""What a program may give for legs, servos and angles, and what it is told where it is something else."""

import doctest
import re
from collections.abc import Callable
from decimal import Decimal
from typing import Any

import pytest

from gateway.people.client import payloads
from gateway.people.client.payloads import leg_number, leg_payload, legs_payload, number, row, servo_number


def test_the_examples_are_right() -> None:
    assert doctest.testmod(payloads) == (0, 3)


class Float32:
    """What numpy's floats are to others."""

    def __float__(self) -> float:
        return 45.5


class Int64:
    """What numpy's integers are to others."""

    def __index__(self) -> int:
        return 90


@pytest.mark.parametrize(
    ("given", "sent"),
    [
        (180.0000000000001, 180.0),
        (180.005, 180.0),
        (-1e-15, 0.0),
        (-0.005, 0.0),
        (Decimal("180.001"), 180.0),
        (180.0051, 180.0051),  # for the gateway to reject
        (-0.0051, -0.0051),
        (90.123, 90.123),
        (Float32(), 45.5),
        (Int64(), 90),
    ],
)
def test_what_is_outside_by_arithmetic_only_is_the_limit(given: Any, sent: float) -> None:
    assert number(given) == sent


def test_a_leg_has_three_angles() -> None:
    with pytest.raises(ValueError, match="2 angles; a leg has three joints"):
        leg_payload("start", (1, 2))


@pytest.mark.parametrize("wrong", [{90, 45, 120}, {1: 90, 2: 45, 3: 120}, "abc", b"abc", 90, None])
def test_what_has_no_order_of_joints_is_no_leg(wrong: Any) -> None:
    with pytest.raises(TypeError, match="a leg's angles are a list, a tuple or an array of three"):
        legs_payload("set", {3: wrong})


@pytest.mark.parametrize("wrong", [[(90, 45, 120)], (90, 45, 120), None])
def test_several_legs_are_a_dict(wrong: Any) -> None:
    with pytest.raises(TypeError, match=r"legs and their angles are a dict, such as \{3: \(90, 45, 120\)\}, and not "):
        legs_payload("start", wrong)


@pytest.mark.parametrize("wrong", [[90, 45, 120], True, "90", None])
def test_what_is_no_number_is_no_angle(wrong: Any) -> None:
    with pytest.raises(TypeError, match=rf"an angle is a number of degrees, and not {re.escape(repr(wrong))}"):
        leg_payload("set", row((wrong, 45, 120)))


@pytest.mark.parametrize(
    ("call", "wrong", "error", "sentence"),
    [
        (leg_number, "3", TypeError, "a leg is a whole number, and not '3'; legs are 1 to 6"),
        (leg_number, 3.0, TypeError, "a leg is a whole number, and not 3.0; legs are 1 to 6"),
        (leg_number, True, TypeError, "a leg is a whole number, and not True; legs are 1 to 6"),
        (leg_number, 7, ValueError, "leg 7 does not exist; legs are 1 to 6"),
        (servo_number, "32", TypeError, "a servo is a whole number, and not '32'; an id is the leg"),
        (servo_number, 14, ValueError, "servo 14 does not exist; an id is the leg"),
    ],
)
def test_a_leg_or_servo_that_is_none_is_reported(
    call: Callable[[object], int], wrong: object, error: type[Exception], sentence: str
) -> None:
    with pytest.raises(error) as raised:
        call(wrong)
    assert str(raised.value).startswith(sentence)
