"""The bus: what is written after batches that failed, and what a controller makes of it.

When else the preamble is written stands below; how a batch goes to the device, in test_bus_device.py.
"""

import itertools
import random
from collections.abc import Iterable, Iterator, Sequence

import pytest

from gateway.errors import SpiError
from gateway.host.settings_table import SpiSettings
from gateway.model.frames import Frame, OneLeg, OneServo, Op, ServoOp, stop_leg
from gateway.model.framing import ZERO, Framing
from gateway.robot.spi import ByteDevice
from gateway.robot.spi.bus import IDLE_NS, RESYNC_NS, Bus
from schemas.robot import LEGS
from tests.support.controllers import Controller
from tests.support.transfers import on_wire, preamble_of

PREFIXED = Framing.LENGTH_PREFIXED
START_11 = OneServo(11, ServoOp(Op.START, 6_00))
START_2 = OneLeg(2, (ServoOp(Op.START, 6_06), ServoOp(Op.START, 14_02), ServoOp(Op.START, 6_14)))
"""Angles that look like lengths to a controller out of sync."""
START_ALL = [OneLeg(leg, (ServoOp(Op.START, 90_00),) * 3) for leg in LEGS]
STOP_ALL = [stop_leg(leg) for leg in LEGS]


class FailingDevice(ByteDevice):
    """Passes transfers on to a controller, and fails those with certain numbers, counted from `begin`."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self.begin(())

    def begin(self, failing: Iterable[int]) -> None:
        self._failing = frozenset(failing)
        self._numbers = itertools.count()
        self.seen: list[bytes] = []

    def take(self, data: bytes) -> None:
        self.seen.append(data)
        if next(self._numbers) in self._failing:
            raise SpiError("told to fail")
        self._controller.take(data)


class Scene:
    """A controller with all 18 servos on, and the bus that has started them."""

    def __init__(self, framing: Framing) -> None:
        self.framing = framing
        self.controller = Controller(framing, clock=lambda: 0)
        self.device = FailingDevice(self.controller)
        self.bus = Bus(
            SpiSettings(speed_hz=2_500_000, framing=framing, frame_gap_us=framing.least_gap_us),
            lambda: self.device,
            clock=lambda: 0,
        )
        self.bus.open()
        assert self.bus.write(START_ALL).fault is None
        assert len(self.controller.energised) == 18
        self.device.begin(())


def few_of(count: int) -> Iterator[tuple[int, ...]]:
    for failures in range(4):
        yield from itertools.combinations(range(count), failures)


def stopped(frames: Sequence[Frame], heard: Iterable[int]) -> set[int]:
    return {servo_id for place in heard for servo_id, _ in frames[place].servos}


@pytest.mark.lengthy
@pytest.mark.parametrize("framing", Framing)
@pytest.mark.parametrize("first", [START_11, START_2], ids=["servo", "leg"])
def test_wherever_up_to_three_transfers_fail_all_stops_are_written_and_executed(framing: Framing, first: Frame) -> None:
    for failing in few_of(20):
        scene = Scene(framing)
        scene.device.begin(failing)
        moved = scene.bus.write([first])
        report = scene.bus.write(STOP_ALL)
        assert {sent.place for sent in report.sent if sent.received} == set(range(6)), failing
        assert not scene.controller.energised, failing
        assert not scene.controller.corruptions, failing
        failed = any(number < len(scene.device.seen) for number in failing)
        assert (report.fault is not None or moved.fault is not None) is failed, failing


def test_a_batch_of_stops_that_failed_is_written_one_by_one_and_the_first_of_these_once_more() -> None:
    """It brings the controller back where it awaits a body, and is executed where it awaits a length."""
    scene = Scene(PREFIXED)
    scene.device.begin({3})  # the second Stop's body
    report = scene.bus.write(STOP_ALL)
    assert scene.device.seen == on_wire(scene.framing, *STOP_ALL[:2], *reversed(STOP_ALL), STOP_ALL[5])
    assert [(sent.place, sent.received) for sent in report.sent] == [
        (5, False),
        *((place, True) for place in (4, 3, 2, 1, 0, 5)),
    ], "the first ones were most likely written before"
    assert "told to fail" in str(report.fault), "and the batch counts as failed"
    assert scene.bus.errors == 1
    assert not scene.controller.energised


def test_a_frame_that_moves_is_not_tried_again() -> None:
    scene = Scene(PREFIXED)
    scene.device.begin({1})
    report = scene.bus.write(START_ALL)
    assert report.sent == []
    assert scene.device.seen == on_wire(scene.framing, START_ALL[0]), "what is behind the failed one does not leave"


@pytest.mark.lengthy
@pytest.mark.parametrize("share", [0.1, 0.2, 0.3])
def test_a_stop_that_counts_as_received_was_received_though_transfers_fail_by_chance(share: float) -> None:
    """Behind a part of a preamble it would leave a controller that awaits more than a whole one."""
    for seed in range(100):
        chance, scene = random.Random(seed), Scene(PREFIXED)  # noqa: S311
        scene.device.begin(number for number in range(3000) if chance.random() < share)
        report = scene.bus.write(STOP_ALL)
        heard = {sent.place for sent in report.sent if sent.received}
        assert not stopped(STOP_ALL, heard) & scene.controller.energised, seed
        assert len(heard) == 6 or share > 0.2, seed


@pytest.mark.parametrize(("step_ns", "calls"), [(2_000_000, 43), (0, 1000)])
def test_stops_are_not_tried_for_ever(step_ns: int, calls: int) -> None:
    """A call that fails looks at the clock three times, and the next one once before: 300 ms later it is given up."""

    class OnlyZeros(ByteDevice):
        def take(self, data: bytes) -> None:
            if data != ZERO:
                raise SpiError("told to fail")

    now_ns = itertools.count(0, step_ns) if step_ns else itertools.repeat(0)
    bus = Bus(
        SpiSettings(speed_hz=2_500_000, framing=PREFIXED, frame_gap_us=PREFIXED.least_gap_us),
        OnlyZeros,
        clock=lambda: next(now_ns),
    )
    bus.open()
    bus.write(STOP_ALL)
    assert sum(bus.transfer_latency.buckets) == 1 + calls


# ---- the bus in virtual time: when the preamble is written and when not


MS = 1_000_000
START = OneLeg(1, (ServoOp(Op.START, 90_00),) * 3)
SET_11 = OneServo(11, ServoOp(Op.SET, 45_00))
STOP = stop_leg(1)
ZEROS = preamble_of(PREFIXED)
TRANSFER_NS = 50_000


class Bed(ByteDevice):
    """A bus, a device whose transfers take 50 µs, and a clock that moves with them."""

    def __init__(self, framing: Framing = PREFIXED, *, resync_ns: int = RESYNC_NS) -> None:
        self.now_ns = 7_000 * MS
        self.controller = Controller(framing, clock=lambda: self.now_ns)
        self.log: list[bytes] = []
        settings = SpiSettings(speed_hz=2_500_000, framing=framing, frame_gap_us=framing.least_gap_us)
        self.bus = Bus(settings, lambda: self, clock=lambda: self.now_ns, resync_ns=resync_ns)

    def take(self, data: bytes) -> None:
        self.log.append(data)
        self.controller.take(data)
        self.now_ns += TRANSFER_NS

    def write(self, frame: Frame, *, preamble: bool = False) -> None:
        assert self.bus.write([frame], preamble=preamble).fault is None

    def opened(self) -> "Bed":
        """Open, and synchronised by a preamble."""
        self.bus.open()
        while self.bus.announces and self.bus.write_zeros():
            pass
        self.log.clear()
        return self

    @property
    def written(self) -> list[bytes]:
        """What was written since, which is then forgotten."""
        written, self.log = self.log, []
        return written

    def stream(self, duration_ns: int, period_ns: int = 20 * MS) -> list[bytes]:
        """Sets for so long; what was written."""
        end_ns = self.now_ns + duration_ns
        while self.now_ns < end_ns:
            self.write(SET_11)
            self.now_ns += period_ns
        return self.written


# ---- after opening


@pytest.mark.parametrize("frame", [START, STOP], ids=["start", "stop"])
def test_what_comes_first_after_opening_has_the_preamble_ahead_and_nothing_after_it_has(frame: Frame) -> None:
    bed = Bed()
    bed.bus.open()
    assert bed.log == [], "an opened device waits for its Stops"
    bed.write(frame)
    bed.write(START)
    assert bed.written == [*ZEROS, *on_wire(PREFIXED, frame, START)]


@pytest.mark.parametrize("last", ["a frame", "zeros"])
def test_opening_again_writes_it_again_also_behind_what_was_written_well(last: str) -> None:
    bed = Bed().opened()
    if last == "a frame":
        bed.write(START)
    bed.bus.close()
    bed.log.clear()
    bed.bus.open()
    bed.write(STOP)
    assert bed.written == [*ZEROS, *on_wire(PREFIXED, STOP)]
    bed.bus.close()
    assert "closed" in str(bed.bus.write([STOP]).fault)


# ---- repeated Stops


def test_it_goes_before_a_repeated_run_of_stops_and_never_before_a_first_one() -> None:
    bed = Bed().opened()
    bed.write(START)
    bed.write(STOP)
    assert bed.written == on_wire(PREFIXED, START, STOP)
    bed.write(STOP, preamble=True)
    bed.write(stop_leg(2))
    assert bed.written == [*ZEROS, *on_wire(PREFIXED, STOP, stop_leg(2))]


@pytest.mark.parametrize("parts", [1, 2, 3])
def test_what_a_pause_had_time_for_is_not_written_again_and_the_rest_is_added(parts: int) -> None:
    bed = Bed().opened()
    bed.write(STOP)
    assert [bed.bus.write_zeros() for _ in range(parts)] == [True, False, False][:parts]
    bed.write(STOP, preamble=True)
    assert bed.written == [*on_wire(PREFIXED, STOP), *ZEROS, *on_wire(PREFIXED, STOP)]
    assert bed.bus.errors == 0


def test_a_first_stop_comes_into_a_preamble_and_a_frame_that_moves_waits_for_its_end() -> None:
    bed = Bed().opened()
    bed.write(START)
    for frame, zeros in ((STOP, 8), (START, 16)):
        bed.log.clear()
        bed.bus.write_zeros()
        bed.write(frame)
        assert bed.written == [*ZEROS[:zeros], *on_wire(PREFIXED, frame)]
    assert [bed.bus.write_zeros() for _ in range(2)] == [True, False], "and then all sixteen of it"


# ---- a stream that goes on


@pytest.mark.parametrize("resync_ms", [100, 1000, 5000])
def test_a_stream_has_it_once_in_that_time(resync_ms: int) -> None:
    bed = Bed(resync_ns=resync_ms * MS).opened()
    written = bed.stream(20_000 * MS)
    assert written.count(b"\0") / 16 == pytest.approx(20_000 / resync_ms, abs=1 + 20_000 / resync_ms / 5)
    apart = [len(run) for run in b"".join(written).split(bytes(16))]
    assert max(apart) <= 7 * (resync_ms / 20 + 1)


def test_resync_0_is_off() -> None:
    bed = Bed(resync_ns=0).opened()
    assert b"\0" not in bed.stream(20_000 * MS)
    assert bed.bus.resync_due is False


def test_a_pause_is_looked_for_an_eighth_early_and_what_fills_it_counts() -> None:
    bed = Bed().opened()
    due_ms = []
    for _ in range(200):
        bed.write(SET_11)
        if bed.bus.resync_due:
            due_ms.append(bed.now_ns // MS - 7_000)
            while bed.bus.write_zeros():
                pass
            assert bed.bus.resync_due is False
        bed.now_ns += 20 * MS
    assert due_ms == pytest.approx([885, 1770, 2655, 3540], abs=25)


@pytest.mark.parametrize(("early_ns", "due", "zeros"), [(0, True, ZEROS), (1, False, [])])
def test_a_stream_is_resynchronised_from_just_when_it_is_due(early_ns: int, due: bool, zeros: list[bytes]) -> None:
    bed = Bed().opened()
    opened_ns = bed.now_ns
    bed.now_ns = opened_ns + 875 * MS - 2 * TRANSFER_NS - early_ns
    bed.write(SET_11)
    assert bed.bus.resync_due is due
    bed.now_ns = opened_ns + 1000 * MS - early_ns
    bed.log.clear()
    bed.write(SET_11)
    assert bed.written == [*zeros, *on_wire(PREFIXED, SET_11)]


def test_a_first_stop_does_not_wait_for_one_that_is_overdue_and_a_frame_that_moves_does() -> None:
    bed = Bed().opened()
    bed.write(SET_11)
    bed.now_ns += 999 * MS
    bed.write(SET_11)
    bed.now_ns += 500 * MS
    bed.log.clear()
    bed.write(STOP)
    assert bed.bus.resync_due
    bed.write(SET_11)
    assert bed.written == [*on_wire(PREFIXED, STOP), *ZEROS, *on_wire(PREFIXED, SET_11)]


def test_an_idle_second_does_the_same_and_costs_the_next_frame_nothing() -> None:
    bed = Bed().opened()
    bed.write(SET_11)
    for idle_ns, zeros in ((IDLE_NS, []), (IDLE_NS - 1, ZEROS)):
        bed.now_ns += idle_ns
        bed.log.clear()
        bed.write(SET_11)
        assert bed.written == [*zeros, *on_wire(PREFIXED, SET_11)]
