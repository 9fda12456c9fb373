"""Bytes are lost or framed wrongly on the wire: the controller is out of sync, and nothing says so."""

import logging
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.model.frames import Framing
from tests.deaf.faults import Watcher, lose_bytes, lose_transfers, recorded
from tests.deaf.minute import minute, stopped_walk
from tests.deaf.shifts import faults, one_bit, one_more, outcomes, runs, two_bits_of_a_byte, worst
from tests.support.gateway_process import COMMAND
from tests.support.robot import MS

pytestmark = pytest.mark.virtual_time


MINUTE_MS = 60_500
STOP_MS = 2_000
REST_MS = 5_000
"""How long a scene goes on after an emergency stop: until nothing more is written."""


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    """Silence the gateway's log: it reports each stop, thousands of times here."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


def check(found: list[Watcher]) -> None:
    assert not any(each.stops_after_repeat for each in found), "each Stop is executed at the latest with its repeat"
    assert max(each.deaf_ns for each in found) <= 1000 * MS, "a stream is synchronised again within a second"
    assert "out of sync" not in str([each.unasked for each in found]), "nothing moves but by half a body"


def check_alive(found: list[Watcher]) -> None:
    assert not any(each.controller.dead for each in found), "no lost byte kills the firmware"
    assert not any(each.left_on for each in found)


@pytest.mark.parametrize("tick_phase_ns", [0, 437_000])
async def test_a_byte_lost_anywhere(tick_phase_ns: int) -> None:
    found = lose_bytes(await recorded(minute(), MINUTE_MS), every=113, tick_phase_ns=tick_phase_ns)
    assert len(found) > 500
    assert sum(each.missed_first_stops for each in found) > 50, "which the repeats are for"
    assert not any(each.controller.corruptions for each in found), "nor takes it outside its tables"
    check_alive(found)
    check(found)


async def test_an_announcement_or_a_zero_lost_costs_no_controller_and_a_body_does() -> None:
    found = lose_transfers(await recorded(minute(), MINUTE_MS), every=41)
    assert found.keys() == {"a zero", "an announcement", "a body"}
    assert all(len(each) > 90 for each in found.values())
    assert not any(each.missed or each.unasked for each in found["a zero"])
    for kind in ("a zero", "an announcement"):
        check(found[kind])
        check_alive(found[kind])
    assert sum(each.controller.dead is not None for each in found["a body"]) > 0.1 * len(found["a body"])


@pytest.mark.nightly
@pytest.mark.parametrize("run", [1, 2, 3, 5, 9, 14, 20, 39, 100])
async def test_no_bytes_lost_inside_stops_leave_a_servo_on(run: int) -> None:
    """Of the first Stops, of their repeats, and of the runs behind them."""
    log = await recorded(stopped_walk(STOP_MS), STOP_MS + REST_MS)
    found = lose_bytes(log, run=run, since_ns=STOP_MS * MS)
    assert len(found) > 800
    check_alive(found)


@pytest.mark.nightly
async def test_a_fault_in_the_last_run_starts_a_servo_by_a_stops_operation_alone() -> None:
    """Stop (2) becomes Start (1) by two bits, or by a 1 before it; of each fault in the run before, nothing is left."""
    log = await recorded(stopped_walk(STOP_MS), STOP_MS + REST_MS)
    (before_ns, before), (last_ns, last) = runs(log)[-2:]
    assert "on" not in str(outcomes(one_bit(last)))
    for changed in (two_bits_of_a_byte, one_more):
        found = outcomes(changed(last))
        assert found["on"] == 18
        assert not found["dead and on"]
        assert "on" not in str(outcomes(changed(before), [(last_ns - before_ns, last)]))


AVOID = Framing.LENGTH_PREFIXED.avoid_cdeg
ALL_FAULTS = [(servos, what, stream) for servos in (1, 3) for what, stream in faults(servos)]


def test_no_legal_frame_with_one_byte_lost_or_doubled_has_an_id_that_kills() -> None:
    assert AVOID == (1_00, 4_00)
    found = {what: worst(stream, AVOID) for _, what, stream in ALL_FAULTS}
    assert len(ALL_FAULTS) == 2 * (7 + 15)
    assert not any(found.values()), found
    assert any(worst(stream, None) for _, _, stream in ALL_FAULTS), "were it not for the angles that are never sent"


@pytest.mark.parametrize("command", ["run", "stop-servos", "check"])
def test_no_device_is_touched_before_somebody_has_said_the_framing(tmp_path: Path, command: str) -> None:
    device = tmp_path / "spidev0.0"  # as good as any to be opened and written to
    device.touch()
    config = tmp_path / "gateway.toml"
    config.write_text(f'[spi]\ndevice = "{device}"\n')
    env = {name: value for name, value in os.environ.items() if name != "HEXAPOD_SPI__FRAMING"}
    end = subprocess.run(
        [*COMMAND, command, "--config", str(config)], capture_output=True, text=True, check=False, timeout=30, env=env
    )
    assert end.returncode == 2
    unset, document, published = end.stderr.splitlines()
    assert "spi.framing: is not set" in unset
    assert 'published STM32 firmware needs "length-prefixed"' in published
    assert 'protocol document needs "plain"' in document
    assert end.stdout == ""
    assert device.stat().st_size == 0
