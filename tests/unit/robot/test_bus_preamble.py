"""The bus in virtual time: when the preamble is written and when not."""

import pytest

from gateway.robot.protocol.frames import Frame, OneLeg, OneServo, Op, ServoOp, stop_leg
from gateway.robot.protocol.framing import Framing
from gateway.robot.settings import SpiSettings
from gateway.robot.spi.bus import IDLE_NS, Bus, bus_for
from gateway.robot.spi.simulator import SimulatedController
from tests.support.unshared import UnsharedDevice

MS = 1_000_000
PREFIXED = Framing.LENGTH_PREFIXED
START = OneLeg(1, (ServoOp(Op.START, 90_00),) * 3)
SET_11 = OneServo(11, ServoOp(Op.SET, 45_00))
STOP = stop_leg(1)
ZEROS = list(PREFIXED.preamble)
TRANSFER_NS = 50_000


class Bed(UnsharedDevice):
    """A bus, a device whose transfers take 50 µs, and a clock that moves with them."""

    def __init__(self, framing: Framing = PREFIXED, *, resync_ns: int = 1000 * MS) -> None:
        self.now_ns = 7_000 * MS
        self.controller = SimulatedController(framing, clock=lambda: self.now_ns)
        self.log: list[bytes] = []
        self.bus = Bus(lambda: self, framing, frame_gap_us=0, resync_ns=resync_ns, clock=lambda: self.now_ns)

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


def transfers(*frames: Frame) -> list[bytes]:
    return [data for frame in frames for data in PREFIXED.transfers(frame.to_bytes())]


# ---- after opening


@pytest.mark.parametrize("frame", [START, STOP], ids=["start", "stop"])
def test_what_comes_first_after_opening_has_the_preamble_ahead_and_nothing_after_it_has(frame: Frame) -> None:
    bed = Bed()
    bed.bus.open()
    assert bed.log == [], "an opened device waits for its Stops"
    bed.write(frame)
    bed.write(START)
    assert bed.written == [*ZEROS, *transfers(frame, START)]


def test_opening_again_writes_it_again_also_behind_a_frame_that_was_written_well() -> None:
    bed = Bed().opened()
    bed.write(START)
    bed.bus.close()
    bed.log.clear()
    bed.bus.open()
    bed.write(STOP)
    assert bed.written == [*ZEROS, *transfers(STOP)]
    bed.bus.close()
    assert "closed" in str(bed.bus.write([STOP]).fault)


# ---- repeated Stops


def test_it_goes_before_a_repeated_run_of_stops_and_never_before_a_first_one() -> None:
    bed = Bed().opened()
    bed.write(START)
    bed.write(STOP)
    assert bed.written == transfers(START, STOP)
    bed.write(STOP, preamble=True)
    bed.write(stop_leg(2))
    assert bed.written == [*ZEROS, *transfers(STOP, stop_leg(2))]


def test_it_is_not_written_twice_where_a_pause_was_filled_with_it() -> None:
    bed = Bed().opened()
    bed.write(STOP)
    assert [bed.bus.write_zeros() for _ in range(3)] == [True, False, False]
    bed.write(STOP, preamble=True)
    assert bed.written == [*transfers(STOP), *ZEROS, *transfers(STOP)]
    assert bed.bus.errors == 0


def test_what_a_pause_had_no_time_for_is_added() -> None:
    bed = Bed().opened()
    bed.write(STOP)
    assert bed.bus.write_zeros()
    bed.write(STOP, preamble=True)
    assert bed.written == [*transfers(STOP), *ZEROS, *transfers(STOP)]


def test_a_first_stop_comes_into_a_preamble_and_a_frame_that_moves_waits_for_its_end() -> None:
    bed = Bed().opened()
    bed.write(START)
    for frame, zeros in ((STOP, 8), (START, 16)):
        bed.log.clear()
        bed.bus.write_zeros()
        bed.write(frame)
        assert bed.written == [*ZEROS[:zeros], *transfers(frame)]
    assert [bed.bus.write_zeros() for _ in range(2)] == [True, False], "and then all sixteen of it"


# ---- a stream that goes on


@pytest.mark.parametrize("resync_ms", [100, 1000, 5000])
def test_a_stream_has_it_once_in_resync_ms(resync_ms: int) -> None:
    bed = Bed(resync_ns=resync_ms * MS).opened()
    written = bed.stream(20_000 * MS)
    assert written.count(b"\0") / 16 == pytest.approx(20_000 / resync_ms, abs=1 + 20_000 / resync_ms / 5)
    apart = [len(run) for run in b"".join(written).split(bytes(16))]
    assert max(apart) <= 7 * (resync_ms / 20 + 1)


def test_resync_0_is_off() -> None:
    bed = Bed(resync_ns=0).opened()
    assert b"\0" not in bed.stream(20_000 * MS)
    assert bed.bus.resync_due is False


def test_the_settings_say_how_often() -> None:
    bed = Bed()
    for resync_ms, zeros in ((0, 0), (500, 2), (1000, 1)):
        bus = bus_for(
            SpiSettings(framing=PREFIXED, resync_ms=resync_ms, frame_gap_us=0), lambda: bed, clock=lambda: bed.now_ns
        )
        bus.open()
        while bus.write_zeros():
            pass
        bed.log.clear()
        for _ in range(56):
            bus.write([SET_11])
            bed.now_ns += 20 * MS
        assert bed.written.count(b"\0") == 16 * zeros


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
    assert bed.written == [*transfers(STOP), *ZEROS, *transfers(SET_11)]


def test_an_idle_second_does_the_same_and_costs_the_next_frame_nothing() -> None:
    bed = Bed().opened()
    bed.write(SET_11)
    for idle_ns, zeros in ((IDLE_NS, []), (IDLE_NS - 1, ZEROS)):
        bed.now_ns += idle_ns
        bed.log.clear()
        bed.write(SET_11)
        assert bed.written == [*zeros, *transfers(SET_11)]


def test_plain_never_has_it() -> None:
    bed = Bed(Framing.PLAIN).opened()
    bed.write(START)
    bed.write(STOP, preamble=True)
    bed.now_ns += 5000 * MS
    bed.write(START)
    assert bed.written == [frame.to_bytes() for frame in (START, STOP, START)]
    assert not bed.bus.announces
