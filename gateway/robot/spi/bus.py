"""The SPI bus as the service sees it: frames in, batches of transfers out, with framing, guard, pauses and counters.

A batch is one call of the device. Stops are one batch. Frames that move are split, so that a Stop waits for a call of
1 ms at most. A failed batch counts as failed wholly, since any part of it may have been written.

In LENGTH_PREFIXED framing a frame is two transfers: its length (the announcement), then the frame (the body). One lost
byte takes a controller out of sync. It then takes bodies for lengths and executes nothing while traffic lasts, and the
wire gives no sign of that. So the bus resynchronises the controller with the preamble's zeros (`PREAMBLE_ZEROS`):

* after opening and after a failed batch, since it is not known what the controller received;
* before each repeated run of Stops, for a controller that missed the first run;
* once in `resync_ns` of a stream without a pause. An idle second resynchronises the controller by itself.

A first Stop waits for no preamble, unless a batch has just failed.

A failed call may take 200 ms: Linux waits this long for a lost transfer. So failed Stops are tried one by one, each in
its own call, without zeros if a Stop itself resynchronises the controller (`awaited`). The bus remembers across calls
and openings which legs are not stopped yet, and what the controller may await.
"""

import time
from collections.abc import Callable, Sequence
from itertools import repeat
from math import ceil
from operator import attrgetter
from typing import Final

from gateway.errors import BatchRejectedError, SpiError
from gateway.host.settings_table import SpiSettings
from gateway.model.frames import ONE_LEG_LEN, PREAMBLE_ZEROS, ZERO, Frame, Framing
from gateway.robot.spi import Batch, BatchReport, Sent, SpiDevice, Transfer, Wire
from gateway.robot.spi.awaited import ANYTHING, NOTHING, after, after_failure, after_stall
from gateway.robot.spi.guard import check

LONGEST_NS: Final = 1_000_000
"""The longest call for frames that move, from its first bit to its last: a Stop may wait for its end."""
ZERO_PAUSE_US: Final = 100
"""After each zero of a preamble, within the call. The firmware discards an empty message in 489 to 728 cycles at
180 MHz, 4 µs; faster zeros jam it. Frames needed 6 µs, or 20 at twice the estimated cost of its loop, so 100 are ample.
Half of it would save a repeated run of Stops 0.8 ms; a first Stop waits for no zero."""
ZEROS_AT_ONCE: Final = 8
"""Zeros in one call: half a preamble, 0.8 ms."""
CS_CHANGE_NS: Final = 10_000
"""Linux deasserts chip select for this long after each pause."""
IDLE_NS: Final = 1_100_000_000
"""After this long without a transfer the controller awaits an announcement again (1000 ms by its own clock)."""
ZERO_NS: Final = 150_000
"""The longest time of a zero in a pause: its transfer, its share of the call, and a timer's lateness."""
EARLY_SHARE: Final = 8
"""In a stream the zeros become due an eighth of `resync_ns` early, so that a pause in the stream can be used."""
PAUSE_NS: Final = 100_000_000
"""After this long without a call, the device's settings are checked before frames other than repeats: one system call.
During a stream, the gateway's check ten times a second suffices."""
GIVEN_UP: Final = 18
"""After this many failed calls in a row the device is reopened. Each of six Stops has been tried by then."""
INSIST_NS: Final = 300_000_000
"""The most time for trying failed Stops one by one; nothing else is more urgent. With a first and a last call that take
200 ms to fail, the loop is blocked for 0.7 s; systemd waits for 1 s (WatchdogSec=)."""
SLOW_NS: Final = 20_000_000
"""A call that takes this long to fail is a transfer for which Linux waited. Other calls fail within a millisecond."""
RESYNC_NS: Final = 1_000_000_000
"""The longest time in a stream without a preamble. Until the preamble, a controller that lost a byte ignores each Set
and first Stop. A preamble takes 1.8 ms of the bus, so once a second costs 0.2 %."""
STALLED_NS: Final = 900_000_000
"""A call this long counts as failed: the controller gives up a frame 1000 ms after its announcement."""
STALE_NS: Final = 500_000_000
"""Half of the 1000 ms after which the controller gives up a frame. The other half allows for delays between reading the
clock and the first bit on the wire."""
_data_of: Final = attrgetter("data")


class Bus(Wire):
    """Opens and closes the device, and writes batches of frames. Blocks for the time of a call."""

    def __init__(
        self,
        settings: SpiSettings,
        open_device: Callable[[], SpiDevice],
        *,
        clock: Callable[[], int] = time.monotonic_ns,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        """`pause` sleeps between transfers for a kernel that takes no lists."""
        super().__init__()
        self._open_device = open_device
        self._clock = clock
        self._pause = pause
        self.announces = settings.framing is Framing.LENGTH_PREFIXED
        """Whether frames have announcements, so that a controller can be out of sync."""
        # mutants accepted (Step): an empty range
        self._avoid_cdeg = range(*settings.framing.avoid_cdeg) if settings.framing.avoid_cdeg else range(0)
        self._size = 2 if self.announces else 1
        self._gap_us = ceil(settings.frame_gap_us)
        self._zero: Transfer = ZERO, max(self._gap_us, ZERO_PAUSE_US)
        self.preamble_ns = PREAMBLE_ZEROS * (self._zero[1] * 1000 + ZERO_NS)
        """The longest time of a preamble in parts."""
        gap_ns, byte_ns = self._gap_us * 1000 + CS_CHANGE_NS, 8_000_000_000 // settings.speed_hz
        # mutants accepted (Step): a nanosecond
        frame_ns = byte_ns * ONE_LEG_LEN + (byte_ns + gap_ns if self.announces else 0)
        self._most_moves = (LONGEST_NS + gap_ns) // (frame_ns + gap_ns)
        self._device: SpiDevice | None = None
        # mutants accepted (Forget, Step): opening sets them
        self._most = self._stops_at_once = self._moves_at_once = self._plain_at_once = 1
        """The most transfers of a call, the most Stops, the most frames that move, and those without announcements."""
        self._lists = True  # until the kernel rejects one
        self._awaited = ANYTHING if self.announces else NOTHING
        # mutants accepted (FalseWithTrue, Forget): opening sets it
        self._suspect = False  # the device was reopened, and the controller may be out of sync since
        self._slow = False  # a call failed slowly, and no `write` since then passed all Stops and a preamble
        self._received: set[bytes] = set()  # Stops that the controller received since Stops began to fail
        self._ended_ns = 0  # when the last call ended  # mutants accepted (Step): long ago
        self._synchronised_ns = 0  # when the last preamble ended  # mutants accepted (Step): long ago
        self._zeros = 0  # in a row, since the last other transfer  # mutants accepted (Forget, Step): opening sets it
        self._failures = 0  # of calls, in a row  # mutants accepted (Step): counting begins anew for Stops

    def open(self) -> None:
        """Close the device if it is open, and open it. Raises SpiError if that fails."""
        self.close()
        try:
            self._device = self._open_device()
        except SpiError:
            self.errors += 1
            raise
        self._most = self._device.most_transfers
        self._stops_at_once = max(1, self._most // self._size)
        self._moves_at_once = max(1, min(self._stops_at_once, self._most_moves))
        self._plain_at_once = 0 if self.announces else self._moves_at_once

    # mutants accepted (Step): all stop, or none; nobody gives 1
    def write(self, frames: Sequence[Frame], *, preamble: bool = False) -> BatchReport:
        """Write frames that all stop, or that all move. `preamble` marks Stops of a repeated run. Return what was sent.

        After a fault the device stays open, and failed Stops are tried one by one before this returns. While calls fail
        slowly, further Stops are written one by one, too, since a batch after a preamble would hardly ever pass.
        """
        report, stops = BatchReport(), frames[0].is_stop
        now_ns = self._clock()
        if self._device is None:
            self.errors += 1
            report.fault = SpiError("the SPI device is closed")
            return report
        if not preamble and now_ns - self._ended_ns >= PAUSE_NS:
            report.meddled = self.put_right()
            if report.meddled is not None and not stops:
                report.fault = SpiError(report.meddled)
                return report
        if stops:
            self._write_stops(frames, report, now_ns, preamble=preamble)
        else:
            try:
                if len(frames) <= self._plain_at_once:
                    self._write_plain(frames, report)
                else:
                    self._write_batches(frames, report, now_ns, stops=False, preamble=preamble)
            except SpiError as fault:
                report.fault = fault
        if report.fault is not None:
            self.errors += 1
        return report

    def _write_stops(self, frames: Sequence[Frame], report: BatchReport, now_ns: int, *, preamble: bool) -> None:
        one_by_one = self._slow
        try:
            if one_by_one:
                self._insist(frames, report)
                if report.fault is None:
                    self._write_preamble(report)
            else:
                self._write_batches(frames, report, now_ns, stops=True, preamble=preamble)
        except SpiError as fault:
            report.fault = report.fault or fault
            if not one_by_one:
                self._insist(frames, report)
        if report.fault is None and (self._slow or self._received):
            self._slow = False
            self._received.clear()

    # mutants accepted (Step): fewer zeros than none are none
    def _write_batches(
        self, frames: Sequence[Frame], report: BatchReport, now_ns: int, *, stops: bool, preamble: bool
    ) -> None:
        zeros = 0
        if self.announces and self._needs_preamble(now_ns, stops=stops, preamble=preamble):
            zeros = PREAMBLE_ZEROS - self._zeros
            if not stops or zeros + self._size * len(frames) > self._most:
                self._write_preamble(report)
                zeros = 0
        at_once = self._stops_at_once if stops else self._moves_at_once
        for first in range(0, len(frames), at_once):
            self._call(report, zeros, frames[first : first + at_once], first)
            zeros = 0

    def _needs_preamble(self, now_ns: int, *, stops: bool, preamble: bool) -> bool:
        if preamble or self._suspect or self._awaited != NOTHING:
            return not self.just_resynchronised
        if now_ns - self._ended_ns >= IDLE_NS:
            self._synchronised_ns = now_ns
        # A begun preamble is finished first. If each frame restarted it, it would never end.
        overdue = now_ns - self._synchronised_ns >= RESYNC_NS or bool(self._zeros)
        return overdue and not stops and not self.just_resynchronised

    def _write_preamble(self, report: BatchReport) -> None:
        """Write the rest of a preamble. Raises SpiError."""
        while self.announces and not self.just_resynchronised:
            self._write_part(report)

    def _write_part(self, report: BatchReport) -> None:
        at_once = min(ZEROS_AT_ONCE, self._most) if self._lists else 1
        self._call(report, min(at_once, PREAMBLE_ZEROS - self._zeros))

    def write_zeros(self) -> bool:
        if self._device is None or self.just_resynchronised:
            return False
        try:
            self._write_part(BatchReport())
        except SpiError:
            self.errors += 1
            raise
        return not self.just_resynchronised

    @property
    def resync_due(self) -> bool:
        return self.announces and self._ended_ns - self._synchronised_ns >= RESYNC_NS - RESYNC_NS // EARLY_SHARE

    @property
    def just_resynchronised(self) -> bool:
        return self._zeros >= PREAMBLE_ZEROS

    def close(self) -> None:
        if self._device is not None:
            self._device.close()
        self._device = None
        self._suspect = self.announces
        self._zeros = 0

    # ---- one call

    # mutants accepted (LtE_Lt, Lt_LtE, Step, Sub_Add): equal times; longer than a stall either way
    def _call(self, report: BatchReport, zeros: int, frames: Sequence[Frame] = (), first: int = 0) -> None:
        """Write zeros, then these frames, in one call. `first` is the first frame's place. Raises SpiError."""
        if self.announces:
            self._write_announced(report, zeros, frames, first)
        else:
            self._write_plain(frames, report, first)

    def _write_plain(self, frames: Sequence[Frame], report: BatchReport, first: int = 0) -> None:
        batch = list(zip(map(_data_of, frames), repeat(self._gap_us), strict=False))
        self._transfer(batch, report, frames, first, True)

    def _write_announced(self, report: BatchReport, zeros: int, frames: Sequence[Frame], first: int) -> None:
        gap_us, awaited, zeros_before = self._gap_us, self._awaited, self._zeros + zeros
        batch = [self._zero] * zeros
        for frame in frames:
            batch += [(frame.data[:1], gap_us), (frame.data, gap_us)]
        if frames:
            self._zeros = 0  # failed zeros are not counted; if they arrived, more do no harm
        received = awaited == NOTHING or max(awaited) <= zeros
        self._transfer(batch, report, frames, first, received)
        if awaited != NOTHING:
            self._awaited = after(awaited, b"".join(each for each, _ in batch))
        if zeros and zeros_before >= PREAMBLE_ZEROS:
            self._synchronised_ns, self._suspect = self._ended_ns, False
        if not frames:
            self._zeros = zeros_before

    def _transfer(self, batch: Batch, report: BatchReport, frames: Sequence[Frame], first: int, received: bool) -> None:
        """Check a batch, write it, and report its frames as sent. Raises SpiError, and IllegalTransferError."""
        check(batch, self._avoid_cdeg, announces=self.announces)
        write = self._device.transfer if self._lists and self._device is not None else self._write_singly
        begun_ns = self._clock()
        try:
            try:
                write(batch)
            except BatchRejectedError as rejection:
                if not self._lists:  # a part of the batch may have been written
                    raise
                self._write_singly(batch)
                self._lists, report.rejection = False, str(rejection)
        except SpiError:
            self._failed(batch, self._clock() - begun_ns)
            raise
        finally:
            self._ended_ns = ended_ns = self._clock()
            took_ns = ended_ns - begun_ns
            self.transfer_latency.record(took_ns)
        if took_ns >= STALLED_NS:
            self._failed(batch, took_ns)
            raise SpiError(f"the SPI device took {took_ns / 1e9:.1f} s for a call of milliseconds")
        self._failures = 0
        self.frames += len(frames)
        if frames:
            report.sent.append(Sent(first, len(frames), ended_ns, took_ns, received))

    def _write_singly(self, batch: Batch) -> None:
        """Write a batch in one call for each transfer, for a kernel that takes no lists, and sleep the pauses.

        Write no body if the program was suspended for too long after its announcement. Raises SpiError.
        """
        written_ns = None
        for data, pause_us in batch:
            # mutants accepted (Gt_GtE): equal times
            if written_ns is not None and self._clock() - written_ns > STALE_NS:
                raise SpiError("this program was suspended between the two transfers of a frame")
            written_ns = self._clock()
            if self._device is not None:
                self._device.transfer(((data, 0),))
            self._pause(pause_us / 1e6)

    # ---- Stops that failed

    def _failed(self, batch: Batch, took_ns: int) -> None:
        """Record a failed call, of which any part may have been written."""
        self._failures += 1
        self._slow = self._slow or took_ns >= SLOW_NS
        if self.announces:
            lost = after_stall if took_ns >= STALLED_NS else after_failure
            self._awaited = lost(self._awaited, [data for data, _ in batch])

    def _insist(self, frames: Sequence[Frame], report: BatchReport) -> None:
        """Write each Stop in its own call until the controller has received it, or INSIST_NS are over.

        The report gets the first failure.
        """
        written = {place for sent in report.sent for place in sent.places}
        # The transfers before the failed one have most likely arrived, so the last Stops come first; but before them,
        # legs without a Stop from an earlier call.
        left = [place for place in reversed(range(len(frames))) if place not in written]
        left.sort(key=lambda place: frames[place].data in self._received)
        self._failures, give_up_ns, untried = 0, self._clock() + INSIST_NS, [*left]
        while left and self._failures < GIVEN_UP and self._clock() < give_up_ns:
            try:
                if not untried and self._awaited != NOTHING:
                    self._call(report, 1)  # a longer call fails more often
                    continue
                untried = untried or [*left]
                place = untried.pop(0)
                # mutants accepted (Step): fewer zeros than none are none
                self._call(report, 0, (frames[place],), place)
                if report.sent[-1].received:
                    left.remove(place)
                    self._received.add(frames[place].data)
            except SpiError as fault:
                report.fault, untried = report.fault or fault, untried or [*left]
        if left:
            report.fault = report.fault or SpiError("the SPI device did not accept all Stops in time")
