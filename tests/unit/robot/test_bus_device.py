"""The bus and its device: opened, guarded, counted, closed, and the batches that it is given."""

import itertools
from collections.abc import Sequence
from math import ceil

import pytest

from gateway.errors import SpiError
from gateway.host.settings_table import SpiSettings
from gateway.model.frames import PREAMBLE_ZEROS, ZERO, Frame, Framing, OneServo, Op, ServoOp
from gateway.robot.spi import Sent
from gateway.robot.spi.bus import LONGEST_NS, ZERO_PAUSE_US, Bus
from gateway.robot.spi.guard import IllegalTransferError
from schemas.robot import LEGS
from tests.support.bus_scenes import MOVES, STOPS, Bench, wire_ns
from tests.support.transfers import on_wire

PREFIXED = Framing.LENGTH_PREFIXED
SERVO_STOPS = [OneServo(10 * leg + joint, ServoOp(Op.STOP)) for leg in LEGS for joint in (1, 2, 3)]


# ---- what leaves together


@pytest.mark.parametrize("count", [6, 8])
def test_a_preamble_and_the_stops_behind_it_are_one_call_of_bounded_length(count: int) -> None:
    bench = Bench()
    bench.bus.write(SERVO_STOPS[:count], preamble=True)
    (batch,) = bench.batches
    assert batch[:PREAMBLE_ZEROS] == ((ZERO, ZERO_PAUSE_US),) * PREAMBLE_ZEROS
    assert len(batch) == PREAMBLE_ZEROS + 2 * count
    assert wire_ns(batch) < 3_000_000, "the longest call there is, at the default pause"


@pytest.mark.parametrize("framing", Framing)
@pytest.mark.parametrize("frame_gap_us", [0, 50, 100, 400, 1000])
def test_what_moves_is_split_so_that_no_call_takes_more_than_a_millisecond(framing: Framing, frame_gap_us: int) -> None:
    bench = Bench(framing, frame_gap_us=max(frame_gap_us, framing.least_gap_us))
    report = bench.bus.write([*MOVES, *MOVES])
    assert bench.frames == [move.data for move in [*MOVES, *MOVES]]
    assert [sent.place for sent in report.sent] == list(range(12))
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
    [(Framing.PLAIN, 18, [18]), (PREFIXED, 9, [8, 8, 18]), (PREFIXED, 18, [8, 8, 32, 4])],
)
def test_what_is_too_long_for_one_call_leaves_in_more(framing: Framing, count: int, sizes: list[int]) -> None:
    bench = Bench(framing)
    assert bench.bus.write(SERVO_STOPS[:count], preamble=True).fault is None
    preamble = [ZERO] * PREAMBLE_ZEROS if framing is PREFIXED else []
    assert (bench.written, bench.sizes) == ([*preamble, *on_wire(framing, *SERVO_STOPS[:count])], sizes)


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
    assert report.sent == [Sent(place, bench.now_ns, bench.now_ns - begun_ns, received=True) for place in (0, 1)]


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
def test_what_it_opens_is_guarded(takes_lists: bool) -> None:
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
