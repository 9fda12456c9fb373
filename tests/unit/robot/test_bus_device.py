"""The bus and its device: opened, guarded, counted, closed, and the batches that it is given."""

import pytest

from gateway.errors import BatchRejectedError, SpiError
from gateway.robot.protocol.frames import Frame, OneLeg, OneServo, Op, ServoOp, stop_leg
from gateway.robot.protocol.framing import PREAMBLE_ZEROS, ZERO, Framing
from gateway.robot.settings import SpiSettings
from gateway.robot.spi import Batch
from gateway.robot.spi.bus import CS_CHANGE_NS, LONGEST_NS, ZERO_PAUSE_US, Bus
from gateway.robot.spi.guard import IllegalTransferError
from schemas.robot import LEGS
from tests.support.unshared import UnsharedDevice

PREFIXED = Framing.LENGTH_PREFIXED
START = OneLeg(1, (ServoOp(Op.START, 90_00),) * 3)
STOP = stop_leg(1)
STOPS = [stop_leg(leg) for leg in LEGS]
MOVES = [OneLeg(leg, (ServoOp(Op.SET, 90_00),) * 3) for leg in LEGS]
SERVO_STOPS = [OneServo(10 * leg + joint, ServoOp(Op.STOP)) for leg in LEGS for joint in (1, 2)]


class Devices(UnsharedDevice):
    """Opens devices that all write to one list; a call takes as long as the wire needs, and those in `failing` fail."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.opened = self.open_now = 0
        self.calls: list[Batch] = []
        self.failing: set[int] = set()
        """Numbers of calls, from when it was set."""
        self.takes_lists = True
        self.stall_ns = 0
        """By how much the next pause takes longer."""
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
        if len(batch) > 1 and not self.takes_lists:
            raise BatchRejectedError("no lists here")
        self.calls.append(tuple(batch))
        self.now_ns += wire_ns(batch) + batch[-1][1] * 1000

    def close(self) -> None:
        self.open_now -= 1

    def pause(self, duration_s: float) -> None:
        self.now_ns += round(duration_s * 1e9) + self.stall_ns
        self.stall_ns = 0

    def clock(self) -> int:
        return self.now_ns

    def bus(self, framing: Framing = PREFIXED, *, frame_gap_us: float = 50, batch: bool = True) -> Bus:
        settings = SpiSettings(framing=framing, frame_gap_us=frame_gap_us, batch=batch, resync_ms=0)
        bus = Bus(settings, self.open, clock=self.clock, pause=self.pause)
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
    assert [data for data, _ in batch] == [data for stop in STOPS for data in framing.transfers(stop.to_bytes())]
    assert {pause_us for _, pause_us in batch} == {50}, "also behind the last: another program may write next"


def test_a_preamble_and_the_stops_behind_it_are_one_call_of_bounded_length() -> None:
    devices = Devices()
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
    bus = devices.bus(framing, frame_gap_us=frame_gap_us)
    report = bus.write([*MOVES, *MOVES])
    assert frames_of(devices.calls) == [move.to_bytes() for move in [*MOVES, *MOVES]]
    assert [sent.place for sent in report.sent] == list(range(12))
    a_frame = 2 if bus.announces else 1
    for batch in devices.calls:
        assert len(batch) % a_frame == 0, "a frame is never split"
        assert wire_ns(batch) <= LONGEST_NS or len(batch) == a_frame
    if frame_gap_us == 50:
        assert max(devices.sizes) == 6 * a_frame if bus.announces else 10, "six legs are one call"


def test_zeros_of_a_stream_are_two_calls() -> None:
    devices = Devices()
    bus = devices.bus()
    bus.write([STOP])
    devices.calls.clear()
    assert [bus.write_zeros() for _ in range(3)] == [True, False, False]
    assert devices.sizes == [8, 8]
    assert all(wire_ns(batch) <= LONGEST_NS for batch in devices.calls)


@pytest.mark.parametrize("most", range(1, 33))
@pytest.mark.parametrize("preamble", [False, True])
def test_a_device_that_takes_less_gets_the_same_in_more_calls(most: int, preamble: bool) -> None:
    for frames in (STOPS, MOVES, SERVO_STOPS):
        devices = Devices()
        devices.most_transfers = most
        bus = devices.bus()
        assert bus.write(frames, preamble=preamble).fault is None
        written = [data for batch in devices.calls for data, _ in batch]
        zeros = [ZERO] * PREAMBLE_ZEROS if preamble else []
        assert written == [*zeros, *(data for frame in frames for data in PREFIXED.transfers(frame.to_bytes()))]
        assert max(devices.sizes) <= max(2, most), "an announcement and its body stay together"


def test_each_frame_has_its_own_time_by_its_place_on_the_wire() -> None:
    devices = Devices()
    bus = devices.bus()
    devices.now_ns = 0
    report = bus.write(STOPS[:2], preamble=True)
    zeros_ns = PREAMBLE_ZEROS * (3200 + 100_000 + CS_CHANGE_NS)
    frame_ns = 3200 + 50_000 + CS_CHANGE_NS + 14 * 3200
    assert [sent.ns for sent in report.sent] == [zeros_ns + frame_ns, zeros_ns + 2 * frame_ns + 50_000 + CS_CHANGE_NS]
    assert {sent.call_ns for sent in report.sent} == {devices.now_ns}
    assert [sent.data for sent in report.sent] == [stop.to_bytes() for stop in STOPS[:2]]


# ---- one call each


@pytest.mark.parametrize("framing", Framing)
def test_without_batches_the_same_is_written_transfer_by_transfer(framing: Framing) -> None:
    devices = Devices()
    assert devices.bus(framing, batch=False).write(STOPS).fault is None
    assert devices.sizes == [1] * len(STOPS) * (2 if framing is PREFIXED else 1)
    assert {batch[0][1] for batch in devices.calls} == {0}, "the pauses are slept"
    assert frames_of(devices.calls) == [stop.to_bytes() for stop in STOPS]


@pytest.mark.parametrize("stall_ms", [501, 1100])
def test_without_batches_a_stall_within_a_frame_is_a_fault_and_stops_are_tried_anew(stall_ms: int) -> None:
    devices = Devices()
    bus = devices.bus(batch=False)
    devices.stall_ns = stall_ms * 1_000_000
    report = bus.write([STOP])
    assert "stood still" in str(report.fault)
    assert [sent.heard for sent in report.sent] == [True]
    written = [data for batch in devices.calls for data, _ in batch]
    assert written == [b"\x0e", *[ZERO] * PREAMBLE_ZEROS, *PREFIXED.transfers(STOP.to_bytes())]


def test_what_a_kernel_rejects_as_a_list_is_written_one_by_one_at_once_and_so_is_all_that_follows() -> None:
    devices = Devices()
    devices.takes_lists = False
    bus = devices.bus(Framing.PLAIN)
    report = bus.write(STOPS)
    assert (report.fault, report.rejection) == (None, "no lists here")
    assert [sent.place for sent in report.sent] == list(range(6))
    assert devices.sizes == [1] * 6
    bus.open()
    assert bus.write(STOPS).rejection is None, "published once"
    assert bus.errors == 0


def test_what_is_rejected_one_by_one_as_well_is_no_matter_of_lists() -> None:
    devices = Devices()
    bus = devices.bus(Framing.PLAIN)
    devices.takes_lists = False
    devices.fail(2)
    report = bus.write(MOVES)
    assert (str(report.fault), report.rejection, report.sent) == ("told to fail", None, [])
    devices.takes_lists = True
    devices.calls.clear()
    bus.write(STOPS)
    assert devices.sizes == [6]


# ---- opened, guarded, counted


def test_a_device_that_cannot_be_opened_is_an_error() -> None:
    def fails() -> Devices:
        raise SpiError("told to fail")

    bus = Bus(SpiSettings(framing=PREFIXED), fails)
    with pytest.raises(SpiError):
        bus.open()
    assert bus.errors == 1
    assert "closed" in str(bus.write([STOP]).fault)


def test_opening_again_releases_what_was_open() -> None:
    devices = Devices()
    bus = devices.bus()
    for _ in range(5):
        bus.open()
    assert (devices.opened, devices.open_now) == (6, 1)


def test_what_it_opens_is_guarded() -> None:
    for batch in (True, False):
        devices = Devices()
        bus = devices.bus(Framing.PLAIN, batch=batch)
        illegal = OneServo(11, ServoOp(Op.START, 90_00))
        object.__setattr__(illegal, "servo_id", 99)  # a bug that nobody has made yet
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


def test_zeros_that_fail_count_and_the_next_frame_comes_behind_a_whole_preamble() -> None:
    devices = Devices()
    bus = devices.bus()
    bus.write([START])
    devices.fail(1)
    with pytest.raises(SpiError):
        bus.write_zeros()
    assert bus.errors == 1
    assert not bus.just_resynchronised
    devices.calls.clear()
    bus.write([STOP])
    assert [data for data, _ in devices.calls[0]] == [*[ZERO] * 16, *PREFIXED.transfers(STOP.to_bytes())]


def test_a_preamble_is_whole_after_its_last_part() -> None:
    devices = Devices()
    bus = devices.bus()
    for more in (True, False):
        assert not bus.just_resynchronised
        assert bus.write_zeros() is more
    assert bus.just_resynchronised
    bus.close()
    assert bus.write_zeros() is False


def test_a_frame_is_any_of_the_two_kinds() -> None:
    """Frames of both lengths in one batch keep their places on the wire."""
    devices = Devices()
    mixed: list[Frame] = [OneServo(11, ServoOp(Op.SET, 1)), START]
    bus = devices.bus(Framing.PLAIN)
    devices.now_ns = 0
    first, second = bus.write(mixed).sent
    assert (first.ns, second.ns) == (19_200, 19_200 + 60_000 + 44_800)
