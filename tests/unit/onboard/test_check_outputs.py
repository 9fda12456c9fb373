"""Which output feeds a servo, by the currents at rest and while it moves."""

import datetime as dt
import tomllib

import pytest

from gateway.onboard.check.outputs import ServoCurrents, exchanged, finding
from schemas.telemetry import ServoTelemetry, Telemetry

REST = {"11": 0.008, "12": 0.008, "61": 0.008}


@pytest.mark.parametrize(
    ("moving", "says"),
    [
        ({"11": 0.009, "12": 0.008, "61": 0.4}, "output for servo 61 feeds it (392 mA"),
        ({"11": 0.009, "12": 0.4, "61": 0.008}, "WRONG: servo 61 hangs on the output that it gives to servo 12"),
        ({"11": 0.3, "12": 0.4, "61": 0.008}, "Uncertain: servos 12 and 11"),
        ({"11": 0.009, "12": 0.008, "61": 0.04}, "has measured no current of servo 61"),
        ({"13": 2.0}, "has measured no current of servo 61"),
        ({}, "has measured no current of servo 61"),
    ],
)
def test_what_the_currents_show(moving: dict[str, float], says: str) -> None:
    found = finding(61, REST, moving)
    assert says in found.sentence
    assert found.hangs_on == (12 if "WRONG" in says else None)


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


ORDER = [11, 12, 13, 21, 22, 23, 31, 32, 33, 41, 42, 43, 51, 52, 53, 61, 62, 63]
SWAPPED = [11, 61, *ORDER[2:15], 12, 62, 63]


@pytest.mark.parametrize(
    ("table", "stated"),
    [
        ('interface = "slcan"\n', ORDER),
        ('interface = "slcan"\nservos = []  # the usual ones\nidle_ma = 200\n', ORDER),
        (f"servos = {SWAPPED}\n", SWAPPED),
        ("servos = [\n  " + ",\n  ".join(map(str, ORDER)) + ",\n]\nidle_ma = 200\n", ORDER),
        ("", ORDER),
    ],
)
def test_two_servos_are_exchanged_and_all_else_stays(table: str, stated: list[int]) -> None:
    before = f'[spi]\nframing = "plain"\n\n[power]  # the board\n{table}\n[log]\nlevel = "error"  # quiet\n'
    after = exchanged(before, 61, 12)
    swap = {61: 12, 12: 61}
    read = tomllib.loads(before)
    read["power"]["servos"] = [swap.get(each, each) for each in stated]
    assert tomllib.loads(after) == read
    assert [line for line in after.splitlines() if "#" in line and "servos" not in line] == [
        "[power]  # the board",
        'level = "error"  # quiet',
    ]
    assert exchanged(exchanged(after, 61, 12), 61, 12) == after


@pytest.mark.parametrize(
    "text", ["", "[power.more]\n", 'power = {interface = "slcan"}\n', '[power]\n"servos" = []\n', "["]
)
def test_what_is_written_in_another_way_is_left_alone(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        exchanged(text, 61, 12)
