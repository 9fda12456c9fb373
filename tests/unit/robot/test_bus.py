"""The bus: which calls it makes, in what order, with what time between, and when it gives up.

And what a controller may await after calls that failed. How a batch goes to the device: test_bus_device.py.
"""

import itertools
from typing import Final

import pytest

from gateway.errors import BatchRejectedError
from gateway.host.settings_table import SpiSettings
from gateway.model.frames import STOP, ZERO, Frame, Framing, OneLeg, OneServo, Op, ServoOp
from gateway.robot.spi import Batch, SpiDevice
from gateway.robot.spi.awaited import ANYTHING, NOTHING, after, after_failure
from gateway.robot.spi.bus import Bus
from schemas.robot import LEGS, SERVO_IDS
from tests.support.bus_scenes import MOVES, MS, STOPS, Bench
from tests.support.controllers import Controller
from tests.support.faulty_controller import FaultyController

PREFIXED, PLAIN = Framing.LENGTH_PREFIXED, Framing.PLAIN
START_11 = OneServo(11, ServoOp(Op.START, 6_00))
START_2 = OneLeg(2, (ServoOp(Op.START, 6_06), ServoOp(Op.START, 14_02), ServoOp(Op.START, 6_14)))
"""Angles that look like lengths to a controller out of sync."""
SLOW: Final = "fail 1; failing-takes 200; move → m; fault failed\n failing-takes 0; fail none\n"
"""One frame that moves, and no call after it, failed in 200 ms."""

PREFIXED_SCENES: Final = {
    # ---- when the preamble is written, and when not
    "a frame that moves has the preamble ahead after opening, and nothing has after it": """
        zeros; open → 8z
        move → 8z 8z m
        move → m""",
    "so has a stop, in its call": """
        open; stop 1 → 16z1
        move → m
        open; stop 1 → 16z1
        close; stop 1 → nothing; fault closed""",
    "it goes before a repeated run of stops and never before a first one": """
        move; stop 1 → m 1
        repeat 1 → 16z1
        stop 2 → 2
        zeros; repeat 1 → 8z 8z1""",
    "zeros in a pause end with the whole of it": """
        zeros → 8z; more True; whole False
        zeros → 8z; more False; whole True
        zeros → nothing; more False
        close; zeros → nothing; more False""",
    "a first stop comes into a preamble, and a frame that moves waits for its end": """
        zeros; stop 1 → 8z 1
        zeros; move → 8z 8z m
        zeros; zeros → 8z 8z; more False""",
    "a stream is resynchronised from just when it is due, and a pause is looked for an eighth early": """
        wait 874.999999; move → m; due False
        wait 0.000001; move → m; due True
        wait 124.999999; move → m; due True
        wait 0.000001; move → 8z 8z m; due False""",
    "what fills the pause counts": """
        wait 900; move → m; due True
        zeros; zeros → 8z 8z; due False
        wait 874; move → m; due False""",
    "an idle second does the same and costs the next frame nothing": """
        wait 1100; move → m
        wait 1099.999999; move → 8z 8z m""",
    # ---- calls that fail
    "a batch of stops that failed is written one by one, and the first of these once more": """
        fail 1; stop → 123456 6 5 4 3 2 1 6; fault 123456 failed; sent 6?543216; errors 1""",
    "stops that passed one by one after a fault are followed by no preamble": f"""{SLOW}
        fail 1; stop → 6 5 4 3 2 1 6 5; fault failed""",
    "stops that are not tried in time are a fault": f"{SLOW}stalls 300; stop → 6; fault did not accept all Stops",
    "a frame that moves is not tried again": "fail 1; moves → mmmmmm; fault failed; sent",
    "stops leave together again once all have passed, and a frame that moves does not count": f"""{SLOW}
        move → 8z 8z m
        stop → 6 5 4 3 2 1 8z 8z
        stop → 123456""",
    "stops are tried in turn, then zeros one by one until a stop arrives for certain": """
        open; fail 1 2 3 4 5; stop 1 → 16z1 1 1 1 1 1 z z z z z z z z z z 1; fault 16z1 failed; sent 1?1""",
    "a zero that fails is followed by all stops in turn": """
        open; fail 1 2 3 4 5 11; servo 2 → 16z2s s 2 s 2 s 2 z z z z s 2 …; fault failed""",
    "a stop that passed is not written again for another one": f"""{SLOW}
        move → 8z 8z m
        failing-takes 20; fail with 2; servo 2 → s 2 2 2 …; fault failed; sent 2""",
    # ---- settings that another program changes
    "stops after a pause leave once the settings are put right": """
        wait 100; meddled mode 3; stop → 123456; found mode 3; looks 1""",
    "frames that move do not leave when another program had changed the settings": """
        wait 100; meddled mode 3; moves → nothing; fault mode 3; found mode 3; sent""",
    "without a pause and for repeats nothing is looked at": """
        wait 99.999999; stop; moves; stop → 123456 mmmmmm 123456; looks 0
        wait 100; repeat → 16z123456; looks 0""",
}
PLAIN_SCENES: Final = {
    "from 20 ms on a failure is slow": """
        fail 1; failing-takes 19.999999; move → m; fault failed
        fail none; stop → 123456
        fail 1; failing-takes 20; move → m; fault failed
        fail none; stop → 6 5 4 3 2 1""",
    "a leg whose stop did not pass comes first the next time": """
        fail with 1; stop → 123456 6 5 4 3 2 1 1 …; fault failed
        fail none; stop → 123456
        fail 1; stop → 123456 6 5 4 3 2 1; fault failed  # all have passed between
        fail none; stop; fail with 1; stop → 123456 123456 6 5 4 3 2 1 1 …; fault failed
        fail 1; stop → 123456 1 6 5 4 3 2; fault failed""",
    "what a kernel rejects as a list is written one by one at once, and so is all that follows": """
        lists off; stop → 1 2 3 4 5 6; rejection no lists here; sent 123456
        stop → 1 2 3 4 5 6; rejection None  # published once
        open; stop → 1 2 3 4 5 6; rejection None; errors 0""",
    "what is rejected one by one as well is no matter of lists": """
        lists off; fail 2; moves → m; fault m failed; rejection None; sent
        lists on; fail none; stop; open; stop → 123456 123456""",
}


@pytest.mark.parametrize(
    ("framing", "scene"),
    [(PREFIXED, scene) for scene in PREFIXED_SCENES.values()] + [(PLAIN, scene) for scene in PLAIN_SCENES.values()],
    ids=[*PREFIXED_SCENES, *PLAIN_SCENES],
)
def test_a_scene(framing: Framing, scene: str) -> None:
    Bench(framing).play(scene)


def test_stops_that_fail_are_tried_in_turn() -> None:
    """Eighteen calls in all: then the device is opened again."""
    tries = "6 5 4 3 2 1 " * 3
    Bench(synchronised=False).play(f"open; fail all; stop → 16z123456 {tries}; fault failed")


# ---- what a controller makes of it


@pytest.mark.lengthy
@pytest.mark.parametrize("framing", Framing)
@pytest.mark.parametrize("first", [START_11, START_2], ids=["servo", "leg"])
def test_wherever_up_to_three_transfers_fail_all_stops_are_written_and_executed(framing: Framing, first: Frame) -> None:
    def check(failing: tuple[int, ...]) -> None:
        controller, numbers = FaultyController(framing, clock=lambda: 0, spend=lambda _: None), itertools.count()
        bus = Bus(SpiSettings(speed_hz=2_500_000, framing=framing), lambda: controller, clock=lambda: 0)
        bus.open()
        assert bus.write([OneLeg(leg, (ServoOp(Op.START, 90_00),) * 3) for leg in LEGS]).fault is None
        controller.fail_where(lambda _: next(numbers) in failing)
        bus.write([first])
        report = bus.write(STOPS)
        assert {sent.place for sent in report.sent if sent.received} == set(range(6)), failing
        assert not controller.energised, failing
        assert not controller.corruptions, failing

    for count in range(4):
        for failing in itertools.combinations(range(20), count):
            check(failing)


def test_where_there_are_no_lists_a_rejected_transfer_is_a_failure() -> None:
    """To begin its batch again would send a second announcement: the Stop behind it would be lost, and count."""
    controller, bodies = FaultyController(PREFIXED, clock=lambda: 0, spend=lambda _: None), itertools.count()

    class OneByOne(SpiDevice):
        def transfer(self, batch: Batch) -> None:
            if len(batch) > 1 or (batch[0][0] == STOPS[0].data and next(bodies) == 0):
                raise BatchRejectedError("invalid argument")
            controller.transfer(batch)

    bus = Bus(SpiSettings(speed_hz=2_500_000, framing=PREFIXED), OneByOne, clock=lambda: 0, pause=lambda _: None)
    bus.open()
    assert bus.write([OneLeg(1, (ServoOp(Op.START, 90_00),) * 3)]).fault is None
    report = bus.write(STOPS[:1])
    assert isinstance(report.fault, BatchRejectedError)
    assert [sent.place for sent in report.sent if sent.received] == [0]
    assert not controller.energised


def test_stops_are_not_tried_for_ever() -> None:
    """300 ms later it is given up, though every other call passes."""
    bench = Bench().play("stalls 900; fail with z; failing-takes 10; stop 1 → 1 1 z 1 z 1 z …; fault took 0.9 s")
    assert len(bench.batches) == 61


# ---- a stream that goes on


def test_a_stream_has_the_preamble_once_in_a_second() -> None:
    bench = Bench()
    for _ in range(1000):
        assert bench.bus.write(MOVES[:1]).fault is None
        bench.now_ns += 20 * MS
    assert bench.written.count(ZERO) / 16 == pytest.approx(20, abs=1)
    assert max(len(run) for run in b"".join(bench.written).split(bytes(16))) <= 15 * 51


# ---- what a controller may still await after calls that failed

LEG_STOPS = tuple(stop.data for stop in STOPS)
ALL_STOPS = (*LEG_STOPS, *(OneServo(servo_id, STOP).data for servo_id in SERVO_IDS))


def transfers_of(stop: bytes) -> tuple[bytes, ...]:
    return (ZERO,) if stop == ZERO else (stop[:1], stop)


def awaiting(count: int) -> Controller:
    """A controller with no servo on that awaits so many bytes."""
    controller = Controller(Framing.LENGTH_PREFIXED, clock=lambda: 0)
    controller.take(bytes((count,)))
    assert controller.missing == count
    return controller


@pytest.mark.parametrize("count", range(64))
def test_from_wherever_a_controller_is_stops_and_zeros_start_nothing_and_harm_nothing(count: int) -> None:
    """And what it then awaits is what is computed, for each two of them."""
    for pair in itertools.product((*ALL_STOPS[:8], ALL_STOPS[-1], ZERO), (*ALL_STOPS, ZERO)):
        controller, awaited = awaiting(count), frozenset({count})
        for stop in pair:
            for data in transfers_of(stop):
                controller.take(data)
                awaited = after(awaited, data)
        assert awaited == {controller.missing}, pair
        assert not controller.energised
        assert not controller.corruptions
        assert controller.dead is None


def test_what_may_have_been_lost_is_each_transfer_and_those_behind_it() -> None:
    assert after_failure(NOTHING, ()) == NOTHING
    assert after_failure(NOTHING, [ZERO] * 16) == NOTHING, "zeros do a synchronised controller nothing"
    assert after_failure(NOTHING, transfers_of(LEG_STOPS[0])) == {0, 14}
    assert after_failure(frozenset({0, 14}), transfers_of(LEG_STOPS[0])) == {0, 13, 14}
    assert after_failure(ANYTHING, [ZERO]) == ANYTHING
    assert after(ANYTHING, bytes(14)) == NOTHING
    assert after(ANYTHING, bytes(13)) == {0, 1}, "all 14 bytes of a leg's frame may be missing"
