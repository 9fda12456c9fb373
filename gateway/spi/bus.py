"""The SPI bus as the service sees it: frames in, transfers out, with framing, guard, pauses and counters.

In LENGTH_PREFIXED framing a frame is two transfers: its length (the announcement), then the frame (the body). A
controller gets out of sync by one lost byte, or by a pause of a second between announcement and body. It then takes
bodies for lengths and hears nothing while traffic goes on, and the wire gives no sign of it. So the bus resynchronises
it with the preamble's zeros (`Framing.preamble`):

* after opening, and after a failed transfer, when nobody knows what the controller received;
* before each repeated run of Stops, so that a controller which missed the first run hears the repetition;
* when an announcement is too old for its body; then the zeros and both transfers are written;
* once in `resync_ns` of a stream without a pause. An idle second resynchronises the controller by itself.

A first Stop waits for none of that, unless a transfer has just failed.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final

from gateway.core.latency import Latency
from gateway.errors import SpiError, UnheardError
from gateway.protocol.frames import Frame
from gateway.protocol.framing import PREAMBLE_ZEROS, ZERO, Framing
from gateway.spi import SpiDevice
from gateway.spi.guard import GuardedDevice
from gateway.spi.plain_settings import SpiValues

STALE_ANNOUNCEMENT_NS: Final = 500_000_000
"""Half of the 1000 ms after which the controller gives the body up. The other half allows for delays between the last
look at the clock and the first bit on the wire."""
LOST_BODY_NS: Final = 900_000_000
"""If a body's transfer ended later than this after its announcement, it may have begun too late."""
TRIES: Final = 3
"""Attempts to write a frame whose announcement grew stale, and repetitions of a preamble before a Stop whose zeros
failed. A machine that stalls more often cannot run a robot."""
IDLE_NS: Final = 1_100_000_000
"""After so long without a transfer the controller awaits an announcement again (1000 ms by its own clock)."""
ZERO_NS: Final = 150_000
"""A zero's transfer (50 µs) and a timer's lateness."""
EARLY_SHARE: Final = 8
"""In a stream the zeros become due an eighth of `resync_ns` early, so that a pause in the stream can be used."""


class Bus:
    """Opens the device, closes it after a fault, and writes whole frames; blocks for the time of a transfer."""

    def __init__(
        self,
        open_device: Callable[[], SpiDevice],
        framing: Framing,
        *,
        frame_gap_ns: int,
        resync_ns: int = 0,
        shared_device: bool = False,
        clock: Callable[[], int] = time.monotonic_ns,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        """`resync_ns` 0: a stream without a pause is not resynchronised.

        `shared_device`: another program writes, too. Each does not know when the other's frames end, so the pause is
        made before and after each frame.
        """
        self._open_device = open_device
        self._framing = framing
        self.announces = framing is Framing.LENGTH_PREFIXED
        """Whether a controller can be out of sync at all."""
        self._frame_gap_ns = frame_gap_ns
        self._resync_ns = resync_ns
        self._shared_device = shared_device
        self._clock = clock
        self._pause = pause
        self._device: SpiDevice | None = None
        self.ended_ns = 0
        """When the last transfer ended; after `write` that is the frame's."""
        self._free_ns = 0
        self._synchronised = False  # as far as failed transfers tell
        self._synchronised_ns = 0  # when the last preamble ended
        self._zeros = 0  # in a row, since anything else was written
        self.resync_due = False
        """Whether the stream has lasted so long that its next pause is to be filled with `write_zero`."""
        self.frames = 0
        self.errors = 0
        self.transfer_latency = Latency()
        self.last_transfer, self.last_transfer_ns = b"", 0
        """The last transfer, and how long it took; after `write` that is the frame's."""

    def open(self) -> None:
        """Open the device anew and write the preamble, where the framing has one. Raises SpiError."""
        self.close()
        try:
            self._device = GuardedDevice(self._open_device(), self._framing)
            if self.announces:
                with self._bus_lock():
                    self._resynchronise()
        except SpiError:
            self.errors += 1
            self.close()
            raise

    def write(self, frame: Frame, *, first_repeat: bool = False) -> None:
        """Write one frame. `first_repeat`: it is the first of a repeated run of Stops, so the preamble precedes it.

        Raises SpiError; the device stays open, for the next frame may be a Stop. Raises UnheardError if the frame was
        written all the same.
        """
        try:
            if self.announces:
                with self._bus_lock():
                    self._write_announced(frame, first_repeat=first_repeat)
            else:  # one transfer, which nothing can interrupt
                self._transfer(frame.to_bytes())
        except SpiError as error:
            self.errors += 1
            self.frames += isinstance(error, UnheardError)
            raise
        self.frames += 1

    def stop_servos_at_work(self) -> bool:
        """Whether `stop-servos` stops the servos through the same device now."""
        return self._device is not None and self._device.stop_servos_at_work()

    @property
    def preamble_ns(self) -> int:
        """How long a preamble takes, one zero in each turn of a loop."""
        return PREAMBLE_ZEROS * (self._frame_gap_ns + ZERO_NS)

    def write_zero(self) -> bool:
        """Write one zero of a preamble; returns whether more are to follow. Raises SpiError.

        To be called in a pause of the stream, zero by zero, so that a Stop waits for one zero at most.
        """
        if self._device is not None and self._zeros < PREAMBLE_ZEROS:
            try:
                with self._bus_lock():
                    self._zero()
            except SpiError:
                self.errors += 1
                raise
        return self._device is not None and self._zeros < PREAMBLE_ZEROS

    @property
    def just_resynchronised(self) -> bool:
        """Whether nothing was written since the last whole preamble."""
        return self._zeros >= PREAMBLE_ZEROS

    def close(self) -> None:
        """Release the device, if it is open. Never raises."""
        if self._device is not None:
            with suppress(SpiError):
                self._device.close()
            self._device = None
        self._synchronised = self.resync_due = False
        self._zeros = 0

    @contextmanager
    def _bus_lock(self) -> Iterator[None]:
        if self._device is None:
            raise SpiError("the SPI device is closed")
        with self._device.lock():
            if self._shared_device:
                self._pause(self._frame_gap_ns / 1e9)
            yield
            if self._shared_device:
                self._pause(self._frame_gap_ns / 1e9)

    def _write_announced(self, frame: Frame, *, first_repeat: bool) -> None:
        zeros_fault: SpiError | None = None
        if self._wants_preamble(frame, first_repeat=first_repeat):
            if frame.is_stop:
                # Even if the zeros fail, the Stop is tried: a synchronised controller hears it.
                zeros_fault = self._fault_of_zeros()
            else:
                self._resynchronise()
        self._announce_and_write(frame)
        if zeros_fault is not None:
            self._synchronised = False
            raise UnheardError(
                f"{zeros_fault}; this was in the preamble: the Stop behind it was written, but perhaps not heard"
            ) from zeros_fault
        self.resync_due = (
            self._resync_ns > 0
            and self.ended_ns - self._synchronised_ns >= self._resync_ns - self._resync_ns // EARLY_SHARE
        )

    def _wants_preamble(self, frame: Frame, *, first_repeat: bool) -> bool:
        if first_repeat or not self._synchronised:
            return True
        now_ns = self._clock()
        if now_ns - self.ended_ns >= IDLE_NS:
            self._synchronised_ns = now_ns
        overdue = self._resync_ns > 0 and now_ns - self._synchronised_ns >= self._resync_ns
        # A preamble that was begun is finished first; begun again after each frame, it would never end.
        return (overdue or 0 < self._zeros < PREAMBLE_ZEROS) and not frame.is_stop

    def _announce_and_write(self, frame: Frame) -> None:
        """Write the announcement, then the frame; both again if the machine stalled between them."""
        announcement, body = self._framing.transfers(frame.to_bytes())
        for attempt in range(1, TRIES + 1):
            self._synchronised = False  # until the whole frame is written
            announced_ns = self._transfer(announcement)
            # The clock is read after the pause, which is where a machine most likely stalls.
            if self._wait_for_gap() - announced_ns <= STALE_ANNOUNCEMENT_NS or attempt == TRIES:
                self._transfer(body)
                if self.ended_ns - announced_ns < LOST_BODY_NS:
                    self._synchronised = True
                    return
            if attempt < TRIES:
                self._resynchronise()
        raise UnheardError(f"a frame's two transfers were too far apart, {TRIES} times; this machine stalls")

    def _fault_of_zeros(self) -> SpiError | None:
        """Write the preamble, again from the start when a zero fails; returns the first fault, if any."""
        fault: SpiError | None = None
        for _ in range(TRIES + 1):
            try:
                self._resynchronise()
            except SpiError as error:
                fault = fault or error
            else:
                break
        return fault

    def _resynchronise(self) -> None:
        while self._zeros < PREAMBLE_ZEROS:
            self._zero()

    def _zero(self) -> None:
        zeros, synchronised = self._zeros, self._synchronised
        self._synchronised = False  # if it fails, nobody knows what arrived
        self._transfer(ZERO)
        self._synchronised, self._zeros = synchronised, zeros + 1
        if self._zeros == PREAMBLE_ZEROS:
            self._synchronised, self._synchronised_ns, self.resync_due = True, self.ended_ns, False

    def _wait_for_gap(self) -> int:
        """Wait until the pause after the last transfer is over; returns the time then."""
        now_ns = self._clock()
        if now_ns < self._free_ns:
            self._pause((self._free_ns - now_ns) / 1e9)
            now_ns = self._clock()
        return now_ns

    def _transfer(self, data: bytes) -> int:
        """Write one transfer; returns when it began."""
        if self._device is None:
            raise SpiError("the SPI device is closed")
        self._zeros = 0
        begun_ns = self._clock()
        if begun_ns < self._free_ns:
            begun_ns = self._wait_for_gap()
        try:
            self._device.transfer(data)
        finally:
            self.ended_ns = self._clock()
            self.last_transfer, self.last_transfer_ns = data, self.ended_ns - begun_ns
            self.transfer_latency.record(self.last_transfer_ns)
            self._free_ns = self.ended_ns + self._frame_gap_ns
        return begun_ns


def bus_for(
    settings: SpiValues,
    open_device: Callable[[], SpiDevice],
    *,
    shared_device: bool = False,
    clock: Callable[[], int] = time.monotonic_ns,
    pause: Callable[[float], None] = time.sleep,
) -> Bus:
    """A bus with the framing and the pauses of the settings."""
    return Bus(
        open_device,
        settings.framing,
        frame_gap_ns=round(settings.frame_gap_us * 1000),
        resync_ns=round(settings.resync_ms * 1e6),
        shared_device=shared_device,
        clock=clock,
        pause=pause,
    )
