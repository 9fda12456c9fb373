"""The simulated controller as a device, and the faults it can be told to have, on a virtual clock."""

import pytest

from gateway.errors import SpiError
from gateway.robot.protocol.frames import OneServo, Op, ServoOp, centidegrees
from gateway.robot.protocol.framing import Framing
from tests.unit.robot.test_simulator import MS, START_11, START_LEG_1, STOP_11, Bench


@pytest.fixture(params=list(Framing))
def bench(request: pytest.FixtureRequest) -> Bench:
    return Bench(request.param)


# ---- faults to order


def test_failed_transfers_reach_nobody(bench: Bench) -> None:
    bench.controller.fail_next(2)
    for _ in range(2):
        with pytest.raises(SpiError):
            bench.controller.take(START_11)
    assert not bench.controller.transfers
    bench.send(START_11)
    assert bench.controller.executed == 1


def test_failing_for_a_while(bench: Bench) -> None:
    bench.controller.fail_for_ms(300)
    bench.now_ns += 300 * MS - 1
    with pytest.raises(SpiError):
        bench.send(START_11)
    bench.now_ns += 1
    bench.send(START_11)
    assert bench.controller.energised == {11}


def test_a_silent_controller_hears_nothing_and_transfers_succeed(bench: Bench) -> None:
    bench.controller.silent_for_ms(50)
    bench.send(START_11)
    assert bench.controller.energised == frozenset()
    assert len(bench.controller.transfers) == len(bench.framing.transfers(START_11))
    bench.now_ns += 50 * MS
    bench.send(START_11)
    assert bench.controller.energised == {11}


def test_lost_bytes_may_span_transfers() -> None:
    prefixed = Bench(Framing.LENGTH_PREFIXED)
    prefixed.controller.lose_bytes(7)
    prefixed.send(START_11, STOP_11)
    assert prefixed.said == ["servo 11 stopped"]


def test_a_stalled_transfer_takes_its_time_once(bench: Bench) -> None:
    bench.controller.stall(0.25)
    bench.send(START_11, STOP_11)
    assert bench.slept_s == [0.25]
    assert bench.controller.transfers[0][0] == 5_000_000 * MS + 250 * MS


def test_heal_ends_all_faults(bench: Bench) -> None:
    bench.controller.fail_next(9)
    bench.controller.fail_for_ms(9_000)
    bench.controller.silent_for_ms(9_000)
    bench.controller.lose_bytes(9)
    bench.controller.stall(9.0)
    bench.controller.heal()
    bench.send(START_11)
    assert bench.controller.energised == {11}
    assert bench.slept_s == []


# ---- the device


def test_transfers_are_kept_with_their_time(bench: Bench) -> None:
    bench.now_ns += 7
    bench.send(START_11)
    assert [data for _, data in bench.controller.transfers] == list(bench.framing.transfers(START_11))
    assert {at_ns for at_ns, _ in bench.controller.transfers} == {5_000_000 * MS + 7}


def test_close_leaves_the_controller_as_it_is(bench: Bench) -> None:
    """A gateway that ends, or loses its device, leaves servos energised: that is what stop-servos is for."""
    bench.send(START_LEG_1)
    bench.controller.close()
    bench.controller.close()
    assert bench.controller.energised == {11, 12, 13}
    bench.send(STOP_11)
    assert bench.controller.energised == {12, 13}


def test_angles_on_the_wire_are_angles_of_the_servo(bench: Bench) -> None:
    bench.send(OneServo(11, ServoOp(Op.START, centidegrees(12.34))).to_bytes())
    bench.now_ns += 1_000 * MS
    assert bench.servo(11).angle_deg == pytest.approx(12.34, abs=0.09)  # one step of the pulse
