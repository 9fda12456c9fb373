"""The state is at most 2 048 bytes, and only its texts are cut."""

from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.robot import LEGS, SERVO_IDS
from schemas.state import MAX_STATE_BYTES, LegsReport, StateReport, joined
from schemas.telemetry import (
    CUT,
    Battery,
    ButtonsAlive,
    CommandCounts,
    ConfigReport,
    ControllerReport,
    LeaseReport,
    LoopLag,
    Mode,
    PowerReport,
    SpiCounts,
    StopLatency,
    WatchdogCounts,
    WatchdogState,
)
from tests.support import published

MANY = 2**53 - 1
LONG_MS = 123_456_789_012.34567
WHEN = datetime(2026, 11, 26, 22, 0, 0, 123456, UTC)


def fullest(source: str) -> StateReport:
    """Return every field as long as it can be; each leg has another source, which begins with a number."""

    def name(number: int) -> str:
        return f"{number:02}{source}"[:64]

    angles_deg = [[round(170.01 + (10 * leg + joint) / 100, 2) for joint in (1, 2, 3)] for leg in LEGS]
    legs = {
        "watchdog": [WatchdogState.EXPIRED] * 6,
        "age_ms": [round(LONG_MS, 1)] * 6,
        "angles_deg": angles_deg,
        "targets_deg": [[179.99] * 3] * 6,
        "source": range(6),
    }
    return StateReport(
        config="f" * 8,
        mode=Mode.BUS_FAULT,
        time=WHEN,
        uptime_s=LONG_MS,
        legs=LegsReport.model_validate(legs),
        sources=tuple(map(name, LEGS)),
        source_ids=tuple(f"{leg:032x}" for leg in LEGS),
        commands=CommandCounts(accepted=MANY, rejected=MANY, coalesced=MANY, overflows=MANY, lost=MANY),
        spi=SpiCounts(frames=MANY, errors=MANY),
        watchdog=WatchdogCounts(
            expirations=MANY, stop_latency_us=StopLatency(p50=98765.4321012345, p99=98765.4321012345, max=LONG_MS)
        ),
        estop=MANY,
        estop_source=name(7),
        estop_since=WHEN,
        estop_fault="/var/lib/hexapod-gateway/" + "x" * 400,
        lease=LeaseReport(holder=name(8), verified=True, held_s=LONG_MS, expires_in_ms=LONG_MS, asked_by=name(9)),
        buttons=ButtonsAlive(alive=16, names=tuple(name(number) for number in range(10, 40))),
        loop_lag_us=LoopLag(p50=98765.4321012345, p99=98765.4321012345, max=LONG_MS),
        incident="2026-11-26T22-00-00Z-" + "x" * 60,
        controller=ControllerReport(alive=False, age_ms=LONG_MS),
        battery=Battery(voltage_v=7.400000095367432, percent=80.00000190734863),
        power=PowerReport(
            interface="/dev/serial/by-id/" + "x" * 200, alive=True, supplied=SERVO_IDS, confirmed=False, age_ms=LONG_MS
        ),
    )


NAMES = ["", "x" * 64, "\N{SPIDER}" * 64, "\0" * 64, '"' * 64]


@pytest.mark.parametrize("source", NAMES, ids=["short", "long", "wide", "control", "quotes"])
def test_the_fullest_state_is_at_most_2048_bytes(source: str) -> None:
    state = fullest(source).fitted()
    sent = state.model_dump_json().encode()
    assert len(sent) <= MAX_STATE_BYTES
    assert StateReport.model_validate_json(sent).model_dump_json().encode() == sent
    assert state.legs == fullest(source).legs, "only texts are cut"


@given(st.text(min_size=1, max_size=64), st.text(max_size=400))
def test_no_text_makes_the_state_too_large(source: str, fault: str) -> None:
    state = fullest(source).model_copy(update={"estop_fault": fault}).fitted()
    assert len(state.model_dump_json().encode()) <= MAX_STATE_BYTES


def test_a_cut_name_is_still_its_sources() -> None:
    legs = joined(fullest("x" * 64).fitted(), ConfigReport.model_validate(dict(published.state()))).legs
    assert str(legs[0].source).endswith(CUT)
    name, own, other = "01" + "x" * 62, f"{1:032x}", f"{2:032x}"
    assert legs[0].is_of(name, own), "by its id, if nothing else is left"
    assert not legs[0].is_of(name, other)
    assert legs[0].model_copy(update={"source": "01x" + CUT}).is_of(name)
    assert not legs[0].is_of("02" + "x" * 62)
    assert not legs[0].model_copy(update={"source": CUT}).is_of("anna"), "a name of which nothing is left is nobody's"
