"""The power board as the second way to stop: the real service, spidev, and slcan to a simulated board in its process.

Neither way waits for the other: each is shown with the other one hung.
"""

import os
import time
import tty
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

import pytest

from gateway.people.client.blocking import Client
from schemas.gateway_state import PowerReport
from schemas.keys import servo_command
from schemas.robot import SERVO_IDS
from schemas.words import Kind, Mode, Reason
from tests.hil.bed import SpiTestbed, Transfer
from tests.hil.test_elkapod import ElkapodBed
from tests.hil.wire import LATE_S, START_3, STOPS, Wire, start
from tests.support.boards import RecordedBoard, answers_steadily
from tests.support.child import frozen
from tests.support.fixtures import client_fixture
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.heard import events, servos_on, states
from tests.support.robot import angles_of

pytestmark = pytest.mark.hil

LEG_3: Final = 0b111 << 6
STANDS_STILL_S: Final = 1.0
"""Ten times what a board may be silent."""
FLOOD: Final = 8000
"""Frames a second of another node: a full bus of 1 Mbit/s."""


@pytest.fixture
def wire(spi_testbed: SpiTestbed) -> Wire:
    return Wire(spi_testbed)


@pytest.fixture
def board(tmp_path: Path) -> Iterator[RecordedBoard]:
    with RecordedBoard(tmp_path) as board:
        yield board


@pytest.fixture
def gateway(request: pytest.FixtureRequest, tmp_path: Path, wire: Wire, board: RecordedBoard) -> Iterator[Gateway]:
    """Yield a gateway whose board answers."""
    power = {**board.settings, **getattr(request, "param", {})}
    with start(tmp_path, wire, power=power) as running:
        with running.client() as client:
            states(client).wait(answers_steadily())
        yield running


client = client_fixture("test")


def leg_3_runs(client: Client, wire: Wire, board: RecordedBoard) -> None:
    assert client.start_leg(3, 90, 45, 120).accepted
    wire.expect(START_3)
    board.next("fed", LEG_3)


def power_of(client: Client) -> PowerReport:
    found = client.state().power
    assert found is not None
    return found


def supply_goes(board: RecordedBoard) -> None:
    """Expect the next mask to take all supply, and the board to follow it."""
    assert board.next("mask").mask == 0
    assert board.next("fed").mask == 0


def test_a_servo_is_fed_from_its_start_on_and_its_supply_goes_with_its_stop(
    gateway: Gateway, client: Client, wire: Wire, board: RecordedBoard
) -> None:
    heard = events(client)
    assert {each.mask for each in board.noted if each.what == "mask"} == {0}, "what an earlier run fed is taken"
    assert client.start_leg(3, 90, 45, 120).accepted
    wire.expect(START_3)
    fed = board.next("fed", LEG_3)
    stopped_ns = [each.monotonic_ns for each in wire.bed.transfers if each.data.hex() in STOPS]
    (started_ns,) = [each.monotonic_ns for each in wire.bed.transfers if each.data.hex() == START_3]
    assert max(stopped_ns) < fed.at_ns < started_ns, "its Stop, its supply, its start"

    board.disturb(flood="t1238" + 16 * "0", flood_hz=FLOOD)
    ack = client.estop()
    assert (ack.accepted, ack.confirmed, ack.stop_frames) == (True, True, 6)
    assert ack.confirmed_ms is not None
    wire.expect(*STOPS)
    supply_goes(board)
    heard.wait(lambda event: event.kind is Kind.POWER_CUT)
    board.disturb(flood_hz=0)

    begun = board.skip()
    board.disturb(frame="t06A303FFFF")
    assert board.next("mask").mask == 0, "before the board has come to feed anything"
    heard.wait(lambda event: event.kind is Kind.POWER_FAULT)
    assert client.reset().accepted
    assert client.state().mode is Mode.IDLE
    assert not {each.mask for each in board.noted[begun:] if each.what == "fed"} - {0}, "a reset feeds nothing"
    leg_3_runs(client, wire, board)

    gateway.child.terminate()
    assert gateway.child.wait(LATE_S) == 0
    assert board.next("fed").mask == 0
    assert "that their supply is off" in gateway.child.stderr + gateway.child.stdout


def test_supply_goes_while_a_transfer_on_spi_hangs(client: Client, wire: Wire, board: RecordedBoard) -> None:
    with ThreadPoolExecutor(2) as pool:
        leg_3_runs(client, wire, board)
        board.skip()
        wire.bed.block()
        count = len(wire.bed.transfers)
        pool.submit(client.set_leg, 3, 91, 45, 120)
        wire.bed.wait_for_count(count + 1, LATE_S)
        estop = pool.submit(client.estop)
        supply_goes(board)
        assert len(wire.bed.transfers) == count + 1, "nothing else has reached SPI"
        wire.bed.release()
        assert estop.result(LATE_S).accepted


@pytest.mark.parametrize("gateway", [{"confirm_ms": 100}], indirect=True)
def test_stops_on_spi_leave_while_the_adapter_takes_nothing(client: Client, wire: Wire, board: RecordedBoard) -> None:
    heard = events(client)
    leg_3_runs(client, wire, board)
    with frozen(board.child.pid):
        heard.wait(lambda event: event.kind is Kind.POWER_UNCONFIRMED)
        wire.expect(*STOPS)
        rejected = client.start_leg(3, 90, 45, 120, check=False)
        assert (rejected.accepted, rejected.reason) == (False, Reason.NO_POWER)
        ack = client.estop()
        assert (ack.accepted, ack.confirmed, ack.stop_frames) == (True, False, 6)
        wire.expect(*STOPS)
    assert board.next("fed", 0)


def test_a_line_that_is_cut_is_reported_and_what_runs_is_stopped(
    client: Client, wire: Wire, board: RecordedBoard
) -> None:
    heard = events(client)
    leg_3_runs(client, wire, board)
    board.child.kill()
    heard.wait(lambda event: event.kind is Kind.POWER_UNCONFIRMED)
    wire.expect(*STOPS)
    assert not power_of(client).alive
    assert client.start_leg(3, 90, 45, 120, check=False).reason is Reason.NO_POWER


def test_a_gateway_that_is_killed_leaves_the_supply_to_stop_servos(
    gateway: Gateway, client: Client, wire: Wire, board: RecordedBoard
) -> None:
    leg_3_runs(client, wire, board)
    gateway.child.kill()
    board.skip()
    with wire.bed.spawn([*COMMAND, "stop-servos", "--config", str(gateway.config)]) as child:
        supply_goes(board)
        assert child.wait(LATE_S) == 0, str(child)


def test_with_elkapod_2025_a_servos_supply_is_its_start_and_its_stop(tmp_path: Path, board: RecordedBoard) -> None:
    with ElkapodBed(tmp_path) as robot:
        settings = robot.settings_with(watchdog={"timeout_ms": 10_000}, power=board.settings)
        with Gateway(tmp_path, settings, bed=robot) as gateway, gateway.client() as client:
            robot.wait_for_count(1, LATE_S)
            since = len(robot.events)
            assert client.start_leg(3, 91, 45, 120).accepted
            on = board.next("fed", LEG_3)
            frames = [each for each in robot.events[since:] if isinstance(each, Transfer)]
            first = next(each for each in frames if [*angles_of(each.data).values()][6:9] == [91, 45, 120])
            assert first.monotonic_ns < on.at_ns, "the angle is on the wire before the supply comes"
            board.skip()
            ack = client.ask(servo_command(32), {"op": "stop"}, again=True)
            assert (ack.accepted, ack.confirmed) == (True, True)
            assert board.next("fed").mask == 0b101 << 6
            assert client.estop().confirmed
            assert board.next("fed").mask == 0
            assert {servo.id for leg in client.state().legs for servo in leg.servos} == set(SERVO_IDS)


# ---- faults


def test_a_gateway_that_stood_still_for_a_second_takes_no_board_for_silent(
    gateway: Gateway, client: Client, wire: Wire, board: RecordedBoard
) -> None:
    heard = events(client)
    leg_3_runs(client, wire, board)
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
        ack = client.start_leg(3, 90, 45, 120, check=False)
        assert (ack.accepted, ack.reason) == (False, Reason.NO_POWER)
        stop = client.estop()
        assert (stop.accepted, stop.confirmed, stop.stop_frames) == (True, False, 6)
        wire.expect(*STOPS)
        found = power_of(client)
        assert (found.alive, found.confirmed, found.age_ms) == (False, False, None)
    os.close(ours)
    os.close(theirs)


def test_stop_servos_on_the_same_adapter_takes_the_supply_until_a_reset(
    gateway: Gateway, client: Client, wire: Wire, board: RecordedBoard
) -> None:
    """Both read the one terminal: the gateway does not see the other's masks, and may read all answers to them, so
    that `stop-servos` says that nothing is confirmed (docs/stops.md)."""
    leg_3_runs(client, wire, board)
    begun = board.skip()
    with wire.bed.spawn([*COMMAND, "stop-servos", "--config", str(gateway.config)]) as child:
        assert board.next("fed").mask == 0
        assert child.wait(LATE_S) == 0 or "NOT confirmed" in child.stderr, str(child)
    state = client.state()
    assert state.mode is Mode.IDLE
    assert not servos_on(state)
    assert client.estop().confirmed
    assert [each.mask for each in board.noted[begun:] if each.what == "fed"] == [0], "cut once, never fed again"
    assert client.reset().accepted
    states(client).wait(answers_steadily())
    assert power_of(client).alive
    retries = (client.start_leg(3, 90, 45, 120, check=False).accepted for _ in range(100))
    assert any(retries), "the reset reaches the rule of the supply within a tenth of a second"
