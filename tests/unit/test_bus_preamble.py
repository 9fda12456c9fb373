"""The bus in virtual time: when the preamble is written and when not, stale announcements, and the pauses."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import pytest

from gateway.errors import SpiError, UnheardError
from gateway.protocol.frames import Frame, OneLeg, OneServo, Op, ServoOp, stop_leg
from gateway.protocol.framing import Framing
from gateway.settings import SpiSettings
from gateway.spi.bus import IDLE_NS, TRIES, Bus, bus_for
from gateway.spi.simulator import SimulatedController
from tests.support.unshared import UnsharedDevice

MS = 1_000_000
PREFIXED = Framing.LENGTH_PREFIXED
START = OneLeg(1, (ServoOp(Op.START, 90_00),) * 3)
SET_11 = OneServo(11, ServoOp(Op.SET, 45_00))
STOP = stop_leg(1)
ZEROS = list(PREFIXED.preamble)
TRANSFER_NS = 50_000
GAP_NS = 100_000


class Bed(UnsharedDevice):
    """A bus, a device whose transfers take 50 µs, and a clock that moves with them; a stall before a transfer."""

    def __init__(self, framing: Framing = PREFIXED, *, resync_ns: int = 1000 * MS, shared_device: bool = False) -> None:
        self.now_ns = 7_000 * MS
        self.controller = SimulatedController(framing, clock=lambda: self.now_ns)
        self.log: list[tuple[int, bytes | str]] = []
        self.stalls_ns: dict[int, int] = {}
        """How long the machine stalls in the pause before a transfer, by its number."""
        self.stalls_after_ns: dict[int, int] = {}
        """The same, within the call that made it, once its bytes were out."""
        self._count = 0
        self.bus = Bus(
            lambda: self,
            framing,
            frame_gap_ns=GAP_NS,
            resync_ns=resync_ns,
            shared_device=shared_device,
            clock=lambda: self.now_ns,
            pause=self._pause,
        )

    def _pause(self, duration_s: float) -> None:
        self.log.append((self.now_ns, "pause"))
        self.now_ns += round(duration_s * 1e9) + self.stalls_ns.pop(self._count, 0)

    def transfer(self, data: bytes) -> None:
        self.log.append((self.now_ns, data))
        self.controller.transfer(data)
        self.now_ns += TRANSFER_NS + self.stalls_after_ns.pop(self._count, 0)
        self._count += 1

    @contextmanager
    def lock(self) -> Iterator[None]:
        self.log.append((self.now_ns, "lock"))
        yield
        self.log.append((self.now_ns, "end"))

    def opened(self) -> "Bed":
        self.bus.open()
        self.log.clear()
        self._count = 0
        return self

    @property
    def written(self) -> list[bytes]:
        """What was written since, which is then forgotten."""
        written = [data for _, data in self.log if isinstance(data, bytes)]
        self.log.clear()
        return written

    def stream(self, duration_ns: int, period_ns: int = 20 * MS) -> list[bytes]:
        """Sets for so long; what was written."""
        end_ns = self.now_ns + duration_ns
        while self.now_ns < end_ns:
            self.bus.write(SET_11)
            self.now_ns += period_ns
        return self.written


def transfers(*frames: Frame) -> list[bytes]:
    return [data for frame in frames for data in PREFIXED.transfers(frame.to_bytes())]


# ---- after opening


def test_opening_writes_the_preamble_in_single_transfers_and_once() -> None:
    bed = Bed()
    bed.bus.open()
    assert bed.written == ZEROS
    bed.bus.write(START)
    assert bed.written == transfers(START)


def test_opening_again_writes_it_again_also_behind_a_frame_that_was_written_well() -> None:
    bed = Bed().opened()
    bed.bus.write(START)
    bed.bus.close()
    bed.written.clear()
    bed.bus.open()
    assert bed.written == ZEROS
    bed.bus.close()
    with pytest.raises(SpiError, match="closed"):
        bed.bus.write(STOP)


# ---- repeated Stops


def test_it_goes_before_a_repeated_run_of_stops_and_never_before_a_first_one() -> None:
    bed = Bed().opened()
    bed.bus.write(START)
    bed.bus.write(STOP)
    assert bed.written == transfers(START, STOP)
    bed.bus.write(STOP, first_repeat=True)
    bed.bus.write(stop_leg(2))
    assert bed.written == [*ZEROS, *transfers(STOP, stop_leg(2))]


def test_it_is_not_written_twice_where_a_pause_was_filled_with_it() -> None:
    bed = Bed().opened()
    bed.bus.write(STOP)
    assert [bed.bus.write_zero() for _ in range(17)] == [True] * 15 + [False] * 2
    bed.bus.write(STOP, first_repeat=True)
    assert bed.written == [*transfers(STOP), *ZEROS, *transfers(STOP)]
    assert bed.bus.errors == 0


def test_what_a_pause_had_no_time_for_is_added() -> None:
    bed = Bed().opened()
    bed.bus.write(STOP)
    for _ in range(5):
        bed.bus.write_zero()
    bed.bus.write(STOP, first_repeat=True)
    assert bed.written == [*transfers(STOP), *ZEROS, *transfers(STOP)]


def test_a_first_stop_comes_into_a_preamble_and_a_frame_that_moves_waits_for_its_end() -> None:
    bed = Bed().opened()
    bed.bus.write(START)
    for frame, zeros in ((STOP, 5), (START, 16)):
        bed.written.clear()
        for _ in range(5):
            bed.bus.write_zero()
        bed.bus.write(frame)
        assert bed.written == [*ZEROS[:zeros], *transfers(frame)]
    assert [bed.bus.write_zero() for _ in range(16)] == [True] * 15 + [False], "and then all sixteen of it"


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
            SpiSettings(framing=PREFIXED, resync_ms=resync_ms, frame_gap_us=0),
            lambda: bed,
            clock=lambda: bed.now_ns,
            pause=lambda _: None,
        )
        bus.open()
        bed.written.clear()
        for _ in range(56):
            bus.write(SET_11)
            bed.now_ns += 20 * MS
        assert bed.written.count(b"\0") == 16 * zeros


def test_a_pause_is_looked_for_an_eighth_early_and_what_fills_it_counts() -> None:
    bed = Bed().opened()
    due_ms = []
    for _ in range(200):
        bed.bus.write(SET_11)
        if bed.bus.resync_due:
            due_ms.append(bed.now_ns // MS - 7_000)
            while bed.bus.write_zero():
                pass
            assert bed.bus.resync_due is False
        bed.now_ns += 20 * MS
    assert due_ms == pytest.approx([880, 1780, 2680, 3580], abs=25)


def test_a_first_stop_does_not_wait_for_one_that_is_overdue_and_a_frame_that_moves_does() -> None:
    bed = Bed().opened()
    bed.bus.write(SET_11)
    bed.now_ns += 999 * MS
    bed.bus.write(SET_11)
    bed.now_ns += 500 * MS
    bed.written.clear()
    bed.bus.write(STOP)
    assert bed.bus.resync_due
    bed.bus.write(SET_11)
    assert bed.written == [*transfers(STOP), *ZEROS, *transfers(SET_11)]


def test_an_idle_second_does_the_same_and_costs_the_next_frame_nothing() -> None:
    bed = Bed().opened()
    bed.bus.write(SET_11)
    for idle_ns, zeros in ((IDLE_NS, []), (IDLE_NS - 1, ZEROS)):
        bed.now_ns += idle_ns
        bed.written.clear()
        bed.bus.write(SET_11)
        assert bed.written == [*zeros, *transfers(SET_11)]


def test_plain_never_has_it() -> None:
    bed = Bed(Framing.PLAIN).opened()
    bed.bus.write(START)
    bed.bus.write(STOP, first_repeat=True)
    bed.now_ns += 5000 * MS
    bed.bus.write(START)
    assert bed.written == [frame.to_bytes() for frame in (START, STOP, START)]
    assert not bed.bus.announces


# ---- an announcement that is too old


@pytest.mark.parametrize("within_call", [False, True], ids=["in the pause", "in the call"])
@pytest.mark.parametrize("stall_ms", [501, 999, 1001, 13_000])
@pytest.mark.parametrize("frame", [START, STOP, SET_11], ids=["start", "stop", "set"])
def test_its_body_is_not_sent_but_both_anew_behind_the_zeros(frame: Frame, stall_ms: int, within_call: bool) -> None:
    bed = Bed().opened()
    (bed.stalls_after_ns if within_call else bed.stalls_ns)[0 if within_call else 1] = stall_ms * MS
    bed.bus.write(frame)
    announcement, body = transfers(frame)
    assert bed.written == [announcement, *ZEROS, announcement, body]
    assert bed.controller.executed == 1
    bed.bus.write(frame)
    assert bed.written == [announcement, body]
    assert bed.controller.executed == 2


def test_half_a_second_is_not_too_old() -> None:
    bed = Bed().opened()
    bed.stalls_ns[1] = 499 * MS
    bed.bus.write(START)
    assert bed.written == transfers(START)


@pytest.mark.parametrize("stall_ms", [901, 1001, 5000])
def test_a_body_that_may_have_come_too_late_is_sent_again(stall_ms: int) -> None:
    bed = Bed().opened()
    bed.stalls_after_ns[1] = stall_ms * MS
    bed.bus.write(START)
    assert bed.written == [*transfers(START), *ZEROS, *transfers(START)]


def test_it_is_not_tried_for_ever() -> None:
    """The last try sends the body if it may still be heard; if not even that, the bus is at fault."""
    bed = Bed().opened()
    bed.stalls_after_ns = dict.fromkeys((0, 17, 34), 600 * MS)
    bed.bus.write(STOP)
    announcement, body = transfers(STOP)
    assert [data for data in bed.written if data != b"\0"] == [announcement] * TRIES + [body]
    assert bed.controller.executed == 1
    bed.stalls_after_ns = dict.fromkeys(range(1000), 2000 * MS)
    with pytest.raises(UnheardError, match="this machine stalls"):
        bed.bus.write(STOP)
    assert bed.bus.last_transfer == body, "and not the zeros: it is told as written"
    assert bed.written.count(announcement) == TRIES
    assert (bed.bus.errors, bed.bus.frames) == (1, 2)


# ---- pauses


@pytest.mark.parametrize("framing", Framing)
def test_the_gap_is_from_the_end_of_a_transfer_to_the_begin_of_the_next(framing: Framing) -> None:
    bed = Bed(framing).opened()
    bed.bus.write(START)
    for _ in range(3):
        bed.bus.write(SET_11)
    begins_ns = [at_ns for at_ns, data in bed.log if isinstance(data, bytes)]
    gaps_ns = [later - earlier - TRANSFER_NS for earlier, later in pairwise(begins_ns)]
    assert set(gaps_ns) == {GAP_NS}


def test_a_gap_that_has_passed_is_not_waited_for() -> None:
    bed = Bed(Framing.PLAIN).opened()
    bed.bus.write(START)
    bed.now_ns += GAP_NS
    bed.log.clear()
    bed.bus.write(STOP)
    assert bed.log == [(bed.now_ns - TRANSFER_NS, STOP.to_bytes())]


def test_beside_another_program_the_pause_is_made_on_both_sides_of_a_turn() -> None:
    bed = Bed(shared_device=True).opened()
    bed.now_ns += 50 * MS
    bed.bus.write(STOP)
    announcement, body = transfers(STOP)
    assert [what for _, what in bed.log] == ["lock", "pause", announcement, "pause", body, "pause", "end"]
    assert bed.log[-1][0] - bed.log[-2][0] == GAP_NS
    assert bed.log[2][0] - bed.log[1][0] == GAP_NS
