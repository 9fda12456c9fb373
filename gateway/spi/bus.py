"""The SPI bus as the service sees it: frames in, transfers out, with framing, guard, pauses and counters."""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from typing import Final

from gateway.errors import SpiError
from gateway.latency import Latency
from gateway.protocol.frames import Frame
from gateway.protocol.framing import Framing
from gateway.settings import SpiSettings
from gateway.spi import SpiDevice
from gateway.spi.guard import GuardedDevice

_AT_ONCE: Final = nullcontext()
"""In place of a turn, where a frame is one transfer, which nothing comes into."""


class Bus:
    """Opens the device, closes it after a fault, and writes whole frames; blocks for the time of a transfer."""

    def __init__(
        self,
        open_device: Callable[[], SpiDevice],
        framing: Framing,
        *,
        frame_gap_ns: int,
        beside: bool = False,
        clock: Callable[[], int] = time.monotonic_ns,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        """`beside` another program that writes: it does not know of our frames, so the pause is made on both sides."""
        self._open_device = open_device
        self._framing = framing
        self._frame_gap_ns = frame_gap_ns
        self._beside = beside
        self._clock = clock
        self._pause = pause
        self._device: SpiDevice | None = None
        self._free_ns = 0
        self._in_step = False
        self.frames = 0
        self.errors = 0
        self.transfer_latency = Latency()

    def open(self) -> None:
        """Open the device anew and write the preamble, where the framing has one. Raises SpiError."""
        self.close()
        try:
            self._device = GuardedDevice(self._open_device(), self._framing)
            with self._turn():
                self._get_in_step()
        except SpiError:
            self.errors += 1
            self.close()
            raise

    def write(self, frame: Frame) -> None:
        """Write one frame. Raises SpiError; the device stays open, for the next frame may be a Stop.

        After a failed transfer the preamble comes first: a controller that awaits the body of an announced frame would
        take this one for it, and from then on see lengths where there are none.
        """
        try:
            with self._turn():
                self._get_in_step()
                self._in_step = False  # until the whole frame is written
                for data in self._framing.transfers(frame.to_bytes()):
                    self._transfer(data)
                self._in_step = True
        except SpiError:
            self.errors += 1
            raise
        self.frames += 1

    def close(self) -> None:
        """Release the device, if it is open. Never raises."""
        if self._device is not None:
            with suppress(SpiError):
                self._device.close()
            self._device = None
        self._in_step = False

    def _turn(self) -> AbstractContextManager[None]:
        return _AT_ONCE if self._framing is Framing.PLAIN else self._device_turn()

    @contextmanager
    def _device_turn(self) -> Iterator[None]:
        if self._device is None:
            raise SpiError("the SPI device is closed")
        with self._device.turn():
            if self._beside:
                self._pause(self._frame_gap_ns / 1e9)
            yield
            if self._beside:
                self._pause(self._frame_gap_ns / 1e9)

    def _get_in_step(self) -> None:
        if not self._in_step and self._framing.preamble is not None:
            self._transfer(self._framing.preamble)
        self._in_step = True

    def _transfer(self, data: bytes) -> None:
        if self._device is None:
            raise SpiError("the SPI device is closed")
        wait_ns = self._free_ns - self._clock()
        if wait_ns > 0:
            self._pause(wait_ns / 1e9)
        begun_ns = self._clock()
        try:
            self._device.transfer(data)
        finally:
            ended_ns = self._clock()
            self.transfer_latency.record(ended_ns - begun_ns)
            self._free_ns = ended_ns + self._frame_gap_ns


def bus_for(settings: SpiSettings, open_device: Callable[[], SpiDevice], *, beside: bool = False) -> Bus:
    """A bus with the framing and the pauses of the settings."""
    return Bus(open_device, settings.framing, frame_gap_ns=round(settings.frame_gap_us * 1000), beside=beside)
