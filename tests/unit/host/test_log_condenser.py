"""What a person reads in the journal: each thing once, in its order, and nothing lost."""

import logging
from typing import Any

import pytest

from gateway.host.log_condenser import MOST_HELD, MOST_KINDS, REPEATS_WINDOW_S, Condenser
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


def test_memory_is_bounded(condenser: Condenser) -> None:
    """Strangers choose their keys."""
    found = [each for n in range(1000) for each in condenser.take(rejected(f"{'x' * n}"), 0)]
    assert len(found) == 1000
    again = [condenser.take(rejected(f"{'x' * n}"), 0) for n in range(1000)]
    assert sum(map(len, again)) == 1000 - MOST_KINDS
    condenser.take(silent(1), 1)
    held = [condenser.take(record(f"{n}", logging.INFO), 1) for n in range(MOST_HELD)]
    assert max(map(len, held)) == MOST_HELD
