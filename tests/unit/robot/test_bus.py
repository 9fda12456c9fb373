"""The bus and its device: which calls in which order and time; opened, guarded, counted, closed; when it gives up."""

import itertools
from collections.abc import Sequence
from math import ceil
from typing import Final

import pytest

from gateway.errors import BatchRejectedError, SpiError
from gateway.host.settings_table import SpiSettings
from gateway.model.frames import PREAMBLE_ZEROS, STOP, ZERO, Frame, Framing, OneLeg, OneServo, Op, ServoOp
from gateway.robot.spi import Batch, Sent, SpiDevice
from gateway.robot.spi.awaited import ANYTHING, NOTHING, after, after_failure
from gateway.robot.spi.bus import LONGEST_NS, ZERO_PAUSE_US, Bus
from gateway.robot.spi.guard import IllegalTransferError
from schemas.robot import LEGS, SERVO_IDS
from tests.support.bus_scenes import MOVES, MS, STOPS, Bench, wire_ns
from tests.support.controllers import Controller, FaultyController, on_wire

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
        assert {place for sent in report.sent if sent.received for place in sent.places} == set(range(6)), failing
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
    assert [place for sent in report.sent if sent.received for place in sent.places] == [0]
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
    """Return a controller with no servo on that awaits so many bytes."""
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


SERVO_STOPS = [OneServo(10 * one_leg + joint, ServoOp(Op.STOP)) for one_leg in LEGS for joint in (1, 2, 3)]


# ---- what leaves together


@pytest.mark.parametrize("framing", Framing)
@pytest.mark.parametrize("frame_gap_us", [0, 50, 100, 400, 1000])
def test_what_moves_is_split_so_that_no_call_takes_more_than_a_millisecond(framing: Framing, frame_gap_us: int) -> None:
    bench = Bench(framing, frame_gap_us=max(frame_gap_us, framing.least_gap_us))
    report = bench.bus.write([*MOVES, *MOVES])
    assert bench.frames == [move.data for move in [*MOVES, *MOVES]]
    assert [place for sent in report.sent for place in sent.places] == list(range(12))
    a_frame = 2 if bench.bus.announces else 1
    for batch in bench.batches:
        assert len(batch) % a_frame == 0, "a frame is never split"
        assert wire_ns(batch) <= LONGEST_NS or len(batch) == a_frame
    if frame_gap_us == 50:
        assert max(bench.sizes) == (12 if bench.bus.announces else 10), "six legs are one call"


@pytest.mark.parametrize(
    ("most", "takes_lists", "sizes"),
    [(32, True, [8, 8]), (5, True, [5, 5, 5, 1]), (32, False, [1] * 16)],
    ids=["two calls", "a device that takes less", "one by one"],
)
def test_zeros_of_a_stream_are_written_in_parts(most: int, takes_lists: bool, sizes: list[int]) -> None:
    bench = Bench(most_transfers=most)
    bench.takes_lists = takes_lists
    bench.bus.write(STOPS[:1])
    bench.forget()
    assert [bench.bus.write_zeros() for _ in sizes] == [True] * (len(sizes) - 1) + [False]
    assert bench.sizes == sizes
    assert all(wire_ns(batch) <= LONGEST_NS for batch in bench.batches)
    bench.bus.write(STOPS[:1])
    bench.fails = lambda *_: True
    with pytest.raises(SpiError, match="z failed"):
        bench.bus.write_zeros()
    assert bench.bus.errors == 1


@pytest.mark.parametrize(("frame_gap_us", "preamble_ms"), [(50, 4.0), (400, 8.8)])
def test_a_preamble_takes_16_pauses_and_150_us_for_each_zero(frame_gap_us: int, preamble_ms: float) -> None:
    assert Bench(frame_gap_us=frame_gap_us).bus.preamble_ns == preamble_ms * 1_000_000


@pytest.mark.parametrize(
    ("framing", "count", "sizes"),
    [(PLAIN, 18, [18]), *((PREFIXED, *each) for each in ((6, [28]), (8, [32]), (9, [8, 8, 18]), (18, [8, 8, 32, 4])))],
)
def test_a_preamble_and_its_stops_are_one_call_and_what_is_too_long_leaves_in_more(
    framing: Framing, count: int, sizes: list[int]
) -> None:
    bench = Bench(framing)
    assert bench.bus.write(SERVO_STOPS[:count], preamble=True).fault is None
    preamble = [ZERO] * PREAMBLE_ZEROS if framing is PREFIXED else []
    assert (bench.written, bench.sizes) == ([*preamble, *on_wire(framing, *SERVO_STOPS[:count])], sizes)
    pauses_us = [pause_us for batch in bench.batches for _, pause_us in batch]
    assert set(pauses_us[: len(preamble)]) <= {ZERO_PAUSE_US}
    assert all(wire_ns(batch) < 3_000_000 for batch in bench.batches), "the longest call there is, at the default pause"


@pytest.mark.parametrize("most", range(1, 33))
@pytest.mark.parametrize("preamble", [False, True])
def test_a_device_that_takes_less_gets_the_same_in_more_calls(most: int, preamble: bool) -> None:
    each: tuple[Sequence[Frame], ...] = (STOPS, MOVES, SERVO_STOPS)
    for framing, frames in itertools.product(Framing, each):
        bench = Bench(framing, most_transfers=most)
        a_frame = 2 if bench.bus.announces else 1
        assert bench.bus.write(frames, preamble=preamble).fault is None
        zeros = [ZERO] * PREAMBLE_ZEROS if preamble and bench.bus.announces else []
        assert bench.written == [*zeros, *on_wire(framing, *frames)]
        assert max(bench.sizes) <= max(a_frame, most), "an announcement and its body stay together"
        if frames is not MOVES and not zeros:
            assert len(bench.batches) == ceil(len(frames) / max(1, most // a_frame)), "Stops take no more than needed"


def test_a_frames_time_is_the_end_of_its_call() -> None:
    bench = Bench()
    bench.wire_takes_time = True
    begun_ns = bench.now_ns
    report = bench.bus.write(STOPS[:2], preamble=True)
    assert report.sent == [Sent(0, 2, bench.now_ns, bench.now_ns - begun_ns, received=True)]


# ---- one call each


@pytest.mark.parametrize("framing", Framing)
def test_without_lists_the_same_is_written_transfer_by_transfer(framing: Framing) -> None:
    bench = Bench(framing)
    bench.takes_lists = False
    bench.pause_stall_ns = 499_000_000
    assert bench.bus.write(STOPS).fault is None
    assert {(len(batch), batch[0][1]) for batch in bench.batches} == {(1, 0)}
    assert bench.now_ns % 1_000_000 == 50_000 * len(bench.batches), "the pauses are slept"
    assert bench.written == on_wire(framing, *STOPS)


@pytest.mark.parametrize("stall_ms", [501, 1100])
def test_without_lists_a_stall_within_a_frame_is_a_fault_and_stops_are_tried_anew(stall_ms: int) -> None:
    bench = Bench()
    bench.takes_lists = False
    bench.pause_stall_ns = stall_ms * 1_000_000
    report = bench.bus.write(STOPS[:1])
    assert "was suspended" in str(report.fault)
    assert [sent.received for sent in report.sent] == [False, True]
    stop = on_wire(PREFIXED, STOPS[0])
    between = [ZERO] * (stall_ms > 1000)
    assert bench.written == [b"\x0e", *stop, *between, *stop], "the first of them may complete the body that is missing"


# ---- opened, guarded, counted


def test_a_device_that_cannot_be_opened_is_an_error() -> None:
    def fails() -> Bench:
        raise SpiError("told to fail")

    for framing, frame in itertools.product(Framing, (STOPS[0], MOVES[0])):
        bus = Bus(SpiSettings(speed_hz=2_500_000, framing=framing), fails)
        assert not bus.resync_due
        for errors in (1, 3):
            assert "closed" in str(bus.write([frame]).fault), "before anything was opened, too"
            assert not bus.resync_due
            assert bus.errors == errors
            with pytest.raises(SpiError):
                bus.open()


def test_opening_again_releases_what_was_open() -> None:
    bench = Bench().play("open; open; open")
    assert (bench.openings, bench.open_now) == (4, 1)


@pytest.mark.parametrize("takes_lists", [True, False])
def test_the_device_that_the_bus_opens_is_guarded(takes_lists: bool) -> None:
    bench = Bench(Framing.PLAIN)
    bench.takes_lists = takes_lists
    illegal = OneServo(11, ServoOp(Op.START, 90_00))
    illegal.data = bytes((6, 2, 99, 1, 90, 0))  # a bug that nobody has made yet
    with pytest.raises(IllegalTransferError):
        bench.bus.write([MOVES[0], illegal])
    assert bench.batches == [], "nothing of it"


def test_frames_errors_and_times_are_counted() -> None:
    bench = Bench(Framing.PLAIN)
    bench.wire_takes_time = True
    bench.play("""
        move
        fail 1; move → m m; fault failed; errors 1
        fail none; stop 1 2""")
    assert bench.bus.frames == 4
    assert list(bench.bus.transfer_latency.recent_us)[1:] == [94.8, 0.0, 199.6]
