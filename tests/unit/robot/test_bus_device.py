"""The bus and its device: opened, guarded, counted, closed, and the batches that it is given."""

import itertools
from collections.abc import Sequence
from math import ceil

import pytest

from gateway.errors import BatchRejectedError, SpiError
from gateway.host.settings_table import SpiSettings
from gateway.model.frames import Frame, OneLeg, OneServo, Op, ServoOp, stop_leg
from gateway.model.framing import PREAMBLE_ZEROS, ZERO, Framing
from gateway.robot.spi import Batch, SpiDevice
from gateway.robot.spi.bus import CS_CHANGE_NS, LONGEST_NS, PAUSE_NS, ZERO_PAUSE_US, Bus
from gateway.robot.spi.guard import IllegalTransferError
from schemas.robot import LEGS
from tests.support.transfers import on_wire

PREFIXED = Framing.LENGTH_PREFIXED
START = OneLeg(1, (ServoOp(Op.START, 90_00),) * 3)
STOP = stop_leg(1)
STOPS = [stop_leg(leg) for leg in LEGS]
MOVES = [OneLeg(leg, (ServoOp(Op.SET, 90_00),) * 3) for leg in LEGS]
SERVO_STOPS = [OneServo(10 * leg + joint, ServoOp(Op.STOP)) for leg in LEGS for joint in (1, 2)]


class Devices(SpiDevice):
    """Opens devices that all write to one list; a call takes as long as the wire needs, and those in `failing` fail."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.opened = self.open_now = 0
        self.calls: list[Batch] = []
        self.failing: set[int] = set()
        """Numbers of calls, from when it was set."""
        self.takes_lists, self.rejects_all = True, False
        self.stall_ns = 0
        """By how much the next pause takes longer."""
        self.stops_at_work = False
        self.meddled: str | None = None
        self.looks: list[int] = []
        """How many calls there were at each look at the settings."""
        self._count = 0

    def open(self) -> "Devices":
        self.opened += 1
        self.open_now += 1
        return self

    def fail(self, *calls: int) -> None:
        self.failing, self._count = set(calls), 0

    def transfer(self, batch: Batch) -> None:
        self._count += 1
        if self._count in self.failing:
            raise SpiError("told to fail")
        if self.rejects_all or (len(batch) > 1 and not self.takes_lists):
            raise BatchRejectedError("no lists here")
        self.calls.append(tuple(batch))
        self.now_ns += wire_ns(batch) + batch[-1][1] * 1000

    def close(self) -> None:
        self.open_now -= 1

    def pause(self, duration_s: float) -> None:
        self.now_ns += round(duration_s * 1e9) + self.stall_ns
        self.stall_ns = 0

    def stop_servos_at_work(self) -> bool:
        return self.stops_at_work

    def put_right(self) -> str | None:
        self.looks.append(len(self.calls))
        found, self.meddled = self.meddled, None
        return found

    def clock(self) -> int:
        return self.now_ns

    def bus(self, framing: Framing = PREFIXED, *, frame_gap_us: float = 50) -> Bus:
        settings = SpiSettings(speed_hz=2_500_000, framing=framing, frame_gap_us=frame_gap_us)
        bus = Bus(settings, self.open, clock=self.clock, pause=self.pause, resync_ns=0)
        bus.open()
        assert bus.write([START]).fault is None  # behind the preamble
        self.calls.clear()
        return bus

    @property
    def sizes(self) -> list[int]:
        return [len(batch) for batch in self.calls]


def wire_ns(batch: Batch) -> int:
    """From the first bit to the last, as the emulated device counts it."""
    return sum(3200 * len(data) + pause_us * 1000 + CS_CHANGE_NS for data, pause_us in batch) - (
        batch[-1][1] * 1000 + CS_CHANGE_NS
    )


def frames_of(calls: list[Batch]) -> list[bytes]:
    """The frames, whatever announces them, and however they are split."""
    return [data for batch in calls for data, _ in batch if len(data) > 1]


# ---- what leaves together


@pytest.mark.parametrize("framing", Framing)
def test_stops_are_one_call(framing: Framing) -> None:
    devices = Devices()
    assert devices.bus(framing).write(STOPS).fault is None
    (batch,) = devices.calls
    assert [data for data, _ in batch] == on_wire(framing, *STOPS)
    assert {pause_us for _, pause_us in batch} == {50}, "also behind the last: another program may write next"


def test_a_preamble_and_the_stops_behind_it_are_one_call_of_bounded_length() -> None:
    devices = Devices()
    devices.most_transfers = PREAMBLE_ZEROS + 2 * len(STOPS)
    devices.bus().write(STOPS, preamble=True)
    (batch,) = devices.calls
    assert [data for data, _ in batch[:PREAMBLE_ZEROS]] == [ZERO] * PREAMBLE_ZEROS
    assert {pause_us for _, pause_us in batch[:PREAMBLE_ZEROS]} == {ZERO_PAUSE_US}
    assert len(batch) == PREAMBLE_ZEROS + 2 * len(STOPS)
    assert wire_ns(batch) < 3_000_000, "the longest call there is, at the default pause"


@pytest.mark.parametrize("framing", Framing)
@pytest.mark.parametrize("frame_gap_us", [0, 50, 100, 400, 1000])
def test_what_moves_is_split_so_that_no_call_takes_more_than_a_millisecond(framing: Framing, frame_gap_us: int) -> None:
    devices = Devices()
    bus = devices.bus(framing, frame_gap_us=max(frame_gap_us, framing.least_gap_us))
    report = bus.write([*MOVES, *MOVES])
    assert frames_of(devices.calls) == [move.to_bytes() for move in [*MOVES, *MOVES]]
    assert [sent.place for sent in report.sent] == list(range(12))
    a_frame = 2 if bus.announces else 1
    for batch in devices.calls:
        assert len(batch) % a_frame == 0, "a frame is never split"
        assert wire_ns(batch) <= LONGEST_NS or len(batch) == a_frame
    if frame_gap_us == 50:
        assert max(devices.sizes) == (12 if bus.announces else 10), "six legs are one call"


@pytest.mark.parametrize(
    ("most", "takes_lists", "sizes"),
    [(32, True, [8, 8]), (5, True, [5, 5, 5, 1]), (32, False, [1] * 16)],
    ids=["two calls", "a device that takes less", "one by one"],
)
def test_zeros_of_a_stream_are_written_in_parts(most: int, takes_lists: bool, sizes: list[int]) -> None:
    devices = Devices()
    devices.most_transfers = most
    devices.takes_lists = takes_lists
    bus = devices.bus()
    bus.write([STOP])
    devices.calls.clear()
    assert [bus.write_zeros() for _ in sizes] == [True] * (len(sizes) - 1) + [False]
    assert bus.write_zeros() is False
    assert devices.sizes == sizes
    assert all(wire_ns(batch) <= LONGEST_NS for batch in devices.calls)


@pytest.mark.parametrize(("frame_gap_us", "preamble_ms"), [(50, 4.0), (400, 8.8)])
def test_a_preamble_takes_16_pauses_and_150_us_for_each_zero(frame_gap_us: int, preamble_ms: float) -> None:
    assert Devices().bus(frame_gap_us=frame_gap_us).preamble_ns == preamble_ms * 1_000_000


@pytest.mark.parametrize("most", range(1, 33))
@pytest.mark.parametrize("preamble", [False, True])
def test_a_device_that_takes_less_gets_the_same_in_more_calls(most: int, preamble: bool) -> None:
    each: tuple[Sequence[Frame], ...] = (STOPS, MOVES, SERVO_STOPS)
    for framing, frames in itertools.product(Framing, each):
        devices = Devices()
        devices.most_transfers = most
        bus = devices.bus(framing)
        a_frame = 2 if bus.announces else 1
        assert bus.write(frames, preamble=preamble).fault is None
        written = [data for batch in devices.calls for data, _ in batch]
        zeros = [ZERO] * PREAMBLE_ZEROS if preamble and bus.announces else []
        assert written == [*zeros, *on_wire(framing, *frames)]
        assert max(devices.sizes) <= max(a_frame, most), "an announcement and its body stay together"
        if frames is not MOVES and not zeros:
            assert len(devices.calls) == ceil(len(frames) / max(1, most // a_frame)), "Stops take no more than needed"


def test_each_frame_has_its_own_time_by_its_place_on_the_wire() -> None:
    devices = Devices()
    bus = devices.bus()
    devices.now_ns = begun_ns = 7_000
    report = bus.write(STOPS[:2], preamble=True)
    zeros_ns = PREAMBLE_ZEROS * (3200 + 100_000 + CS_CHANGE_NS)
    frame_ns = 3200 + 50_000 + CS_CHANGE_NS + 14 * 3200
    assert [sent.ns - begun_ns - zeros_ns for sent in report.sent] == [frame_ns, 2 * frame_ns + 50_000 + CS_CHANGE_NS]
    assert {sent.call_ns for sent in report.sent} == {devices.now_ns - begun_ns}
    assert [sent.data for sent in report.sent] == [stop.to_bytes() for stop in STOPS[:2]]


# ---- one call each


@pytest.mark.parametrize("framing", Framing)
def test_without_lists_the_same_is_written_transfer_by_transfer(framing: Framing) -> None:
    devices = Devices()
    devices.takes_lists = False
    assert devices.bus(framing).write(STOPS).fault is None
    assert devices.sizes == [1] * len(STOPS) * (2 if framing is PREFIXED else 1)
    assert {batch[0][1] for batch in devices.calls} == {0}, "the pauses are slept"
    assert frames_of(devices.calls) == [stop.to_bytes() for stop in STOPS]


@pytest.mark.parametrize("stall_ms", [501, 1100])
def test_without_lists_a_stall_within_a_frame_is_a_fault_and_stops_are_tried_anew(stall_ms: int) -> None:
    devices = Devices()
    devices.takes_lists = False
    bus = devices.bus()
    devices.stall_ns = stall_ms * 1_000_000
    report = bus.write([STOP])
    assert "was suspended" in str(report.fault)
    assert [sent.received for sent in report.sent] == [False, True]
    written = [data for batch in devices.calls for data, _ in batch]
    gave_up = [ZERO] * (stall_ms > 1000)
    stops = on_wire(PREFIXED, STOP, STOP)
    assert written == [b"\x0e", *gave_up, *stops], "the first of them may complete the body that is missing"


def test_what_a_kernel_rejects_as_a_list_is_written_one_by_one_at_once_and_so_is_all_that_follows() -> None:
    devices = Devices()
    devices.takes_lists = False
    bus = devices.bus(Framing.PLAIN)
    report = bus.write(STOPS)
    assert (report.fault, report.rejection) == (None, "no lists here")
    assert [sent.place for sent in report.sent] == list(range(6))
    for _ in range(2):
        assert devices.sizes == [1] * 6
        devices.calls.clear()
        report = bus.write(STOPS)
        assert (report.fault, report.rejection) == (None, None), "published once"
        bus.open()
    assert bus.errors == 0


def test_what_is_rejected_one_by_one_as_well_is_no_matter_of_lists() -> None:
    devices = Devices()
    bus = devices.bus(Framing.PLAIN)
    devices.takes_lists = False
    devices.fail(2)
    report = bus.write(MOVES)
    assert (str(report.fault), report.rejection, report.sent) == ("told to fail", None, [])
    devices.takes_lists = True
    for _ in range(2):
        devices.calls.clear()
        bus.write(STOPS)
        assert devices.sizes == [6]
        bus.open()


def test_where_it_fails_one_by_one_after_a_list_was_rejected_nobody_believes_the_first_stop() -> None:
    devices = Devices()
    bus = devices.bus()
    bus.write(STOPS, preamble=True)
    devices.takes_lists = False
    devices.fail(3)
    report = bus.write(STOPS)
    assert str(report.fault) == "told to fail"
    assert [sent.received for sent in report.sent][:2] == [False, True]


def test_what_is_rejected_one_by_one_already_is_a_fault() -> None:
    devices = Devices()
    devices.takes_lists = False
    bus = devices.bus(Framing.PLAIN)
    bus.write(STOPS)
    devices.calls.clear()
    devices.rejects_all = True
    report = bus.write(MOVES)
    assert (str(report.fault), report.rejection) == ("no lists here", None)
    devices.rejects_all = False
    bus.open()
    bus.write(STOPS)
    assert devices.sizes == [1] * 6


# ---- opened, guarded, counted


def test_a_device_that_cannot_be_opened_is_an_error() -> None:
    def fails() -> Devices:
        raise SpiError("told to fail")

    for framing, frame in itertools.product(Framing, (STOP, START)):
        bus = Bus(SpiSettings(speed_hz=2_500_000, framing=framing), fails)
        assert not bus.resync_due
        for errors in (1, 3):
            assert "closed" in str(bus.write([frame]).fault), "before anything was opened, too"
            assert not bus.resync_due
            assert bus.errors == errors
            with pytest.raises(SpiError):
                bus.open()


def test_opening_again_releases_what_was_open() -> None:
    devices = Devices()
    bus = devices.bus()
    for _ in range(5):
        bus.open()
    assert (devices.opened, devices.open_now) == (6, 1)


def test_stop_servos_is_seen_by_the_device_that_is_open() -> None:
    devices = Devices()
    bus = Bus(SpiSettings(speed_hz=2_500_000, framing=PREFIXED), devices.open)
    for devices.stops_at_work in (True, False):
        assert bus.stop_servos_at_work() is None
        bus.open()
        assert bus.stop_servos_at_work() is devices.stops_at_work
        bus.close()


# ---- settings that another program changes


@pytest.mark.parametrize("framing", Framing)
def test_stops_after_a_pause_leave_once_the_settings_are_put_right(framing: Framing) -> None:
    devices = Devices()
    bus = devices.bus(framing)
    devices.looks.clear()
    devices.now_ns = bus.ended_ns + PAUSE_NS
    devices.meddled = "mode 3"
    report = bus.write(STOPS)
    assert (report.fault, report.meddled, len(report.sent)) == (None, "mode 3", len(STOPS))
    assert devices.looks == [0], "before the call"
    assert len(devices.calls) == 1


def test_frames_that_move_do_not_leave_when_another_program_had_changed_the_settings() -> None:
    devices = Devices()
    bus = devices.bus()
    devices.now_ns = bus.ended_ns + PAUSE_NS
    devices.meddled = "mode 3"
    report = bus.write(MOVES)
    assert (str(report.fault), report.meddled, report.sent, devices.calls) == ("mode 3", "mode 3", [], [])


def test_without_a_pause_and_for_repeats_nothing_is_looked_at() -> None:
    devices = Devices()
    bus = devices.bus()
    devices.looks.clear()
    devices.now_ns = bus.ended_ns + PAUSE_NS - 1
    for frames in (STOPS, MOVES, STOPS):
        assert bus.write(frames).fault is None
    devices.now_ns = bus.ended_ns + PAUSE_NS
    assert bus.write(STOPS, preamble=True).fault is None
    assert devices.looks == []


def test_what_it_opens_is_guarded() -> None:
    for takes_lists in (True, False):
        devices = Devices()
        devices.takes_lists = takes_lists
        bus = devices.bus(Framing.PLAIN)
        illegal = OneServo(11, ServoOp(Op.START, 90_00))
        illegal.data = bytes((6, 2, 99, 1, 90, 0))  # a bug that nobody has made yet
        with pytest.raises(IllegalTransferError):
            bus.write([START, illegal])
        assert devices.calls == [], "nothing of it"


def test_frames_errors_and_times_are_counted() -> None:
    devices = Devices()
    bus = devices.bus(Framing.PLAIN)
    bus.write([START])
    devices.fail(1)
    assert bus.write([START]).fault is not None
    bus.write([START, START])
    assert (bus.frames, bus.errors) == (4, 1)
    assert list(bus.transfer_latency.recent_us)[1:] == [94.8, 0.0, 199.6]


def test_a_preamble_is_whole_after_its_last_part() -> None:
    devices = Devices()
    bus = devices.bus()
    for more in (True, False):
        assert not bus.just_resynchronised
        assert bus.write_zeros() is more
    assert bus.just_resynchronised
    bus.close()
    assert bus.write_zeros() is False
