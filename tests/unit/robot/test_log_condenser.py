"""What a person reads in the journal: each thing once, in its order, and nothing lost."""

import logging
from typing import Any

import pytest

from gateway.host.log_condenser import GATHER_S, MOST_HELD, MOST_KINDS, REPEATS_WINDOW_S, Condenser
from schemas.telemetry import Kind


def record(message: str, level: int = logging.WARNING, **fields: Any) -> logging.LogRecord:
    return logging.makeLogRecord({"name": "gateway", "levelno": level, "msg": message, **fields})


def silent(leg: int) -> logging.LogRecord:
    return record(f"leg {leg} was not heard for 250 ms; it is stopped", kind=Kind.WATCHDOG_EXPIRED, legs=(leg,))


def rejected(key: str, message: str = "is no key") -> logging.LogRecord:
    return record(f"{key} {message}", kind=Kind.COMMAND_REJECTED, key=key)


def written(records: list[logging.LogRecord]) -> list[str]:
    return [each.getMessage() for each in records]


@pytest.fixture
def condenser() -> Condenser:
    return Condenser()


def test_a_stop_of_six_legs_is_one_line_and_what_follows_stays_behind_it(condenser: Condenser) -> None:
    lines = [*map(silent, range(1, 7)), record("mode idle", logging.INFO, mode="idle")]
    assert [each for n, line in enumerate(lines) for each in condenser.take(line, n / 1000)] == []
    assert condenser.due_at_s() == GATHER_S
    assert condenser.due(GATHER_S - 0.001) == []
    first, idle = condenser.due(GATHER_S)
    assert written([first, idle]) == [
        "leg 1 was not heard for 250 ms; it is stopped; so are legs 2, 3, 4, 5, 6",
        "mode idle",
    ]
    assert vars(first)["legs"] == (1, 2, 3, 4, 5, 6)
    assert condenser.due_at_s() is None


def test_one_leg_and_two(condenser: Condenser) -> None:
    condenser.take(silent(4), 0)
    assert written(condenser.due(GATHER_S)) == ["leg 4 was not heard for 250 ms; it is stopped"]
    condenser.take(silent(1), 1)
    condenser.take(silent(5), 1)
    assert written(condenser.rest()) == ["leg 1 was not heard for 250 ms; it is stopped; so is leg 5"]
    assert condenser.rest() == []


def test_a_client_on_a_wrong_key_is_one_line_and_one_in_ten_seconds(condenser: Condenser) -> None:
    """Ten events a second, as the gateway publishes them at most."""
    found = [each for n in range(250) for each in condenser.take(rejected("hexapod/lag/3/cmd"), n / 10)]
    assert written(found) == [
        "hexapod/lag/3/cmd is no key",
        f"99 more within {REPEATS_WINDOW_S:g} s, the last: hexapod/lag/3/cmd is no key",
        f"100 more within {REPEATS_WINDOW_S:g} s, the last: hexapod/lag/3/cmd is no key",
    ]
    assert condenser.due_at_s() == pytest.approx(30)
    assert written(condenser.due(30)) == ["50 more within 10 s, the last: hexapod/lag/3/cmd is no key"]
    assert condenser.due(40) == []
    assert condenser.due_at_s() is None
    assert written(condenser.take(rejected("hexapod/lag/3/cmd"), 41)) == ["hexapod/lag/3/cmd is no key"]


def test_numbers_alone_make_no_other_line_but_sources_and_keys_do(condenser: Condenser) -> None:
    lines = [
        rejected("a", "was delayed for 600 ms"),
        rejected("a", "was delayed for 700 ms"),
        rejected("b"),
        rejected("a"),
    ]
    found = [each for line in lines for each in condenser.take(line, 0)]
    assert found == [lines[0], lines[2], lines[3]]
    assert written(condenser.rest()) == ["1 more within 10 s, the last: a was delayed for 700 ms"]


@pytest.mark.parametrize(
    "line",
    [
        record("emergency stop", kind=Kind.ESTOP_ENGAGED),
        record("mode idle", logging.INFO, mode="idle"),
        record("the bus fails", logging.ERROR),
        record("all six legs are stopped", kind=Kind.WATCHDOG_EXPIRED, legs=(1, 2, 3, 4, 5, 6)),
    ],
)
def test_what_is_no_repetition_is_written_each_time_at_once(condenser: Condenser, line: logging.LogRecord) -> None:
    assert [condenser.take(line, n / 10) for n in range(3)] == [[line]] * 3


def test_memory_is_bounded(condenser: Condenser) -> None:
    """Strangers choose their keys."""
    found = [each for n in range(1000) for each in condenser.take(rejected(f"{'x' * n}"), 0)]
    assert len(found) == 1000
    again = [condenser.take(rejected(f"{'x' * n}"), 0) for n in range(1000)]
    assert sum(map(len, again)) == 1000 - MOST_KINDS
    condenser.take(silent(1), 1)
    held = [condenser.take(record(f"{n}", logging.INFO), 1) for n in range(MOST_HELD)]
    assert max(map(len, held)) == MOST_HELD
