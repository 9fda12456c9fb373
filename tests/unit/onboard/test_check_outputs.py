"""Which output feeds a servo, by the currents at rest and while it moves."""

import datetime as dt

import pytest

from gateway.onboard.check.move import ServoCurrents
from schemas.telemetry import ServoTelemetry, Telemetry

REST = {"11": 0.008, "12": 0.008, "61": 0.008}


@pytest.mark.parametrize(
    ("moving", "says"),
    [
        ({"11": 0.009, "12": 0.008, "61": 0.4}, "output for servo 61 feeds it (392 mA"),
        ({"11": 0.009, "12": 0.4, "61": 0.008}, "feeds another servo, or none"),
        ({"11": 0.009, "12": 0.008, "61": 0.04}, "has measured no current of servo 61"),
        ({"13": 2.0}, "has measured no current of servo 61"),
        ({}, "has measured no current of servo 61"),
    ],
)
def test_what_the_currents_show(moving: dict[str, float], says: str) -> None:
    currents = ServoCurrents()
    currents.rest, currents.moving = REST, moving
    assert says in currents.finding(61)


def test_the_highest_of_each_at_rest_and_moving() -> None:
    found = ServoCurrents()

    def take(amperes: float | None) -> None:
        servos = {"61": ServoTelemetry(supplied=True, current_a=amperes)}
        found.take(Telemetry(time=dt.datetime.now(dt.UTC), age_ms=0, servos=servos))

    for amperes in (0.01, 0.02, None, 0.005):
        take(amperes)
    found.moves()
    for amperes in (0.3, 0.5, 0.1):
        take(amperes)
    assert (found.rest, found.moving) == ({"61": 0.02}, {"61": 0.5})
