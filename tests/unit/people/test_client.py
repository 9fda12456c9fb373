"""The client: the names that tools see, the values that a program may pass, and a stop button. No gateway is real."""

import inspect
import json
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from decimal import Decimal
from fractions import Fraction
from typing import Any, cast
from unittest.mock import create_autospec

import numpy as np
import pytest

from gateway.client import Client, RejectedError
from gateway.errors import OutOfRangeError, WalkError
from gateway.people.client.lease_requests import LIFE, REGISTRATION_TRIES, Button
from gateway.people.client.lease_requests import Requests as ClientRequests
from gateway.people.client.payloads import leg_number, leg_payload, legs_angles, legs_payload, number
from gateway.people.walking.gait_speed import Distance
from gateway.people.walking.motion import Velocity
from schemas.ack import Ack
from schemas.button import ButtonAck
from schemas.words import Reason


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
    ],
)
def test_what_is_no_angle_or_leg_is_reported(
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


def test_tools_that_list_the_clients_names_see_each_method() -> None:
    methods = {name for name, _ in inspect.getmembers_static(Client) if not name.startswith("_")}
    assert methods <= set(dir(Client))
    assert {"lease", "button", "on_state"} <= set(dir(create_autospec(Client)))


TIMEOUT_MS = 1000.0


@dataclass
class Requests:
    """A gateway that answers after `takes_s`, and its clock."""

    now_s: float = 1000.0
    takes_s: float = 0.01
    denied: Reason | None = None
    asked: list[str] = field(default_factory=list)

    def button_name(self, _name: str | None) -> str:
        return "kitchen"

    def register(self, _name: str | None) -> ButtonAck:
        return self._answer("register", self.denied)

    def check_in(self, token: str, count: int, *, timeout_s: float | None) -> ButtonAck:
        assert timeout_s == TIMEOUT_MS / 1000
        return self._answer(f"alive {token} {count}")

    def _answer(self, what: str, reason: Reason | None = None) -> ButtonAck:
        self.asked.append(what)
        self.now_s += self.takes_s
        token = f"token {self.asked.count('register')}"
        return ButtonAck(accepted=reason is None, reason=reason, button=token, timeout_ms=TIMEOUT_MS)


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch) -> Requests:
    made = Requests()
    monkeypatch.setattr("gateway.people.client.lease_requests.time.monotonic", lambda: made.now_s)
    return made


def button(requests: Requests) -> Button:
    return Button(cast(ClientRequests, requests), lambda _: Ack(accepted=True), None)


def test_a_button_registers_anew_before_its_clock_may_have_fallen_behind_and_goes_on_if_that_is_denied(
    requests: Requests,
) -> None:
    kitchen = button(requests)
    kitchen.register()
    requests.now_s += LIFE * TIMEOUT_MS / 1000 - 1
    kitchen.alive()
    requests.now_s += 1
    kitchen.alive()
    assert requests.asked == ["register", "alive token 1 1", "register", "alive token 2 1"]
    requests.now_s += LIFE * TIMEOUT_MS / 1000
    requests.denied = Reason.BUTTON_DENIED
    kitchen.alive()
    kitchen.alive()
    assert requests.asked[4:] == ["register", "alive token 2 2", "alive token 2 3"]
    requests.now_s += LIFE * TIMEOUT_MS / 10_000
    kitchen.alive()
    assert requests.asked[-2:] == ["register", "alive token 2 4"], "it tries again"


def test_a_registration_that_was_held_back_does_not_count(requests: Requests) -> None:
    """Each later check-in is compared with it: all of them would count for longer by that delay."""
    kitchen = button(requests)
    requests.takes_s = 0.51
    with pytest.raises(RejectedError, match="stale") as error:
        kitchen.register()
    assert error.value.reason == Reason.STALE
    assert requests.asked == ["register"] * REGISTRATION_TRIES
    requests.takes_s = 0.5
    kitchen.alive()
    assert requests.asked[REGISTRATION_TRIES:] == ["register", f"alive token {REGISTRATION_TRIES + 1} 1"]
