"""A power board with the service, where a gateway stood still, an adapter is mute, or `stop-servos` uses it, too."""

import os
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from gateway.people.client.blocking import Client
from schemas import keys
from schemas.telemetry import GatewayState, Kind, Mode, Reason
from tests.hil.bed import SpiTestbed
from tests.hil.wire import LATE_S, START_3, STOPS, Wire, start
from tests.support.child import frozen
from tests.support.gateway_process import COMMAND
from tests.support.heard import Heard, events
from tests.support.recorded_board import RecordedBoard, answers_steadily

pytestmark = pytest.mark.hil

PATIENT: Final = {"timeout_ms": 10_000}
STANDS_STILL_S: Final = 1.0
"""Ten times what a board may be silent."""


@pytest.fixture
def wire(spi_testbed: SpiTestbed) -> Wire:
    return Wire(spi_testbed)


@pytest.fixture
def board(tmp_path: Path) -> Iterator[RecordedBoard]:
    with RecordedBoard(tmp_path) as board:
        yield board


LEG_3: Final = 0b111 << 6


def until_alive(client: Client) -> None:
    Heard(client, keys.STATE, GatewayState).wait(answers_steadily())


def test_a_gateway_that_stood_still_for_a_second_takes_no_board_for_silent(
    tmp_path: Path, wire: Wire, board: RecordedBoard
) -> None:
    with (
        start(tmp_path, wire, power=board.settings, watchdog=PATIENT) as gateway,
        gateway.client() as client,
    ):
        until_alive(client)
        heard = events(client)
        assert client.start_leg(3, 90, 45, 120).accepted
        wire.expect(START_3)
        board.next("fed", LEG_3)
        with frozen(gateway.child.pid):
            time.sleep(STANDS_STILL_S)
        ack = client.estop()
        assert (ack.accepted, ack.confirmed) == (True, True)
        assert board.next("fed").mask == 0
        heard.wait(lambda event: event.kind is Kind.POWER_CUT)
        assert not [event for event in heard.all if event.kind is Kind.POWER_UNCONFIRMED]


def test_an_adapter_that_opens_and_is_mute_lets_nothing_start_and_holds_up_no_stop(tmp_path: Path, wire: Wire) -> None:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    power = {"interface": "slcan", "channel": os.ttyname(theirs), "confirm_ms": 100}
    with start(tmp_path, wire, power=power) as gateway, gateway.client() as client:
        ack = client.start_leg(3, 90, 45, 120)
        assert (ack.accepted, ack.reason) == (False, Reason.NO_POWER)
        stop = client.estop()
        assert (stop.accepted, stop.confirmed, stop.stop_frames) == (True, False, 6)
        wire.expect(*STOPS)
        power_report = client.state().power
        assert power_report is not None
        assert (power_report.alive, power_report.confirmed, power_report.age_ms) == (False, False, None)
    os.close(ours)
    os.close(theirs)


def test_stop_servos_on_the_same_adapter_takes_the_supply_until_a_reset(
    tmp_path: Path, wire: Wire, board: RecordedBoard
) -> None:
    """Both read the one terminal: the gateway does not see the other's masks, and may read all answers to them, so
    that `stop-servos` says that nothing is confirmed (docs/power.md)."""
    with (
        start(tmp_path, wire, power=board.settings, watchdog=PATIENT) as gateway,
        gateway.client() as client,
    ):
        until_alive(client)
        assert client.start_leg(3, 90, 45, 120).accepted
        wire.expect(START_3)
        board.next("fed", LEG_3)
        begun = board.skip()
        with wire.bed.spawn([*COMMAND, "stop-servos", "--config", str(gateway.config)]) as child:
            assert board.next("fed").mask == 0
            assert child.wait(LATE_S) == 0 or "NOT confirmed" in child.stderr, str(child)
        state = client.state()
        assert state.mode is Mode.IDLE
        assert not any(servo.running for leg in state.legs for servo in leg.servos)
        assert client.estop().confirmed
        assert [each.mask for each in board.noted[begun:] if each.what == "fed"] == [0], "once, and for good"
        assert client.reset().accepted
        until_alive(client)
        power = client.state().power
        assert power is not None
        assert power.alive
        retries = (client.start_leg(3, 90, 45, 120).accepted for _ in range(100))
        assert any(retries), "the reset reaches the rule of the supply within a tenth of a second"
