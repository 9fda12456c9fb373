"""The wire of elkapod-2025 as the service sees it: a frame each cycle over SPI, and starts and Stops over a UART.

Two ways, and neither waits for the other. Stops go over the UART, at once, and are one message whatever they name, so
a transfer that takes 300 ms to fail delays none. Frames go over SPI on a thread of their own (`runtime.cycle`), which
owns the state only between two transfers. What a step wants moved is in the next frame; what it wants started, the UART
shows when the angles were on the wire (`protocol.elkapod.Commanded`).

Where SPI fails, or the controller falls silent or restarts, the UART sends shut down at once, before anything else
learns of it.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from gateway.allowance import NS_PER_S
from gateway.errors import ControllerRestartedError, ControllerSilentError, SpiError
from gateway.model import elkapod
from gateway.model.elkapod import SHUTDOWN, UART_BAUD, Measured
from gateway.model.frames import Frame
from gateway.robot.protocol import BatchReport, Sent, Wire
from gateway.robot.protocol.elkapod import Commanded, SignsOfLife
from gateway.robot.protocol.latency import Latency
from gateway.robot.spi import DuplexDevice
from gateway.robot.spi.guard import IllegalTransferError
from gateway.robot.spi.uart import Uart

_UART_BITS: Final = 11
"""Of a byte: one start bit, eight of data, two stop bits."""
MESSAGE_NS: Final = len(SHUTDOWN) * _UART_BITS * NS_PER_S // UART_BAUD
"""What a message takes on the UART: 95 µs."""


class CyclicBus(Wire):
    """Sends what steps decide. Its owner calls it; `exchange` alone is for the cycle's thread, without the state."""

    def __init__(
        self,
        open_device: Callable[[], DuplexDevice] | None,
        open_uart: Callable[[], Uart],
        *,
        silent_ns: int = 0,
        before_frames_ns: int = 0,
        fed_singly: bool = False,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """`open_device` is None where only Stops are written (`stop-servos`).

        `before_frames_ns`: how long behind an opening no frame is clocked, since a frame moves servos whose shutdown
        was lost, and meanwhile it is repeated. `fed_singly`: a power board starts and stops each servo by its supply.
        """
        self._open_device = open_device
        self._open_uart = open_uart
        self._clock = clock
        self._before_frames_ns = before_frames_ns
        self._device: DuplexDevice | None = None
        self._uart: Uart | None = None
        self._commanded = Commanded(fed_singly=fed_singly)
        self._silent_ns = silent_ns
        self._signs = SignsOfLife(silent_ns, 0)
        self._silent: ControllerSilentError | None = None
        self._frames_ns = 0  # from when on frames are clocked
        self._looked_ns = 0  # when `silent` was last asked
        self._device_failed = self._exchanging = self._abandoned = False
        self.frames = 0
        self.errors = 0
        self.ended_ns = 0
        self.transfer_latency = Latency()

    # ---- for the service

    def open(self) -> None:
        """Open what is not open, and shut down. Raises SpiError, also while the controller is silent."""
        try:
            self._open_and_shut_down()
            if self._device is None and self._open_device is not None:
                self._device = self._open_device()
                self._device_failed = False
                self._frames_ns = self._clock() + self._before_frames_ns
                self._signs = SignsOfLife(self._silent_ns, self._frames_ns)
        except SpiError:
            self.errors += 1
            raise
        if self._silent is not None:
            if not self._signs.alive(self._clock()):
                raise self._silent
            self._silent = None

    def _open_and_shut_down(self) -> None:
        """Over the UART, whatever becomes of SPI. Raises SpiError."""
        if self._uart is None:
            self._uart = self._open_uart()
        try:
            self._uart.write(self._commanded.shut_down())
        except SpiError:
            self._drop_uart()
            raise
        if self._abandoned:
            raise SpiError("the transfer that was under way has not ended")

    def write(self, frames: Sequence[Frame], *, preamble: bool = False) -> BatchReport:  # noqa: ARG002
        """Shut down, or take what moves for the next frame."""
        report, begun_ns = BatchReport(), self._clock()
        stops = frames[0].is_stop
        try:
            if self._uart is None:
                raise SpiError("the UART is closed")
            if self._device is None and not stops:
                raise SpiError("the SPI device is closed")
            if stops:
                message = self._commanded.stop([servo_id for frame in frames for servo_id, _ in frame.servos])
                if message is not None:
                    self._uart.write(message)
            else:
                self._commanded.take(frames)
        except SpiError as fault:
            self.errors += 1
            if stops:
                self._drop_uart()
            report.fault = fault
            return report
        self.ended_ns = self._clock()
        took_ns = self.ended_ns - begun_ns
        left_ns = self.ended_ns + MESSAGE_NS if stops else self.ended_ns
        report.sent = [Sent(place, each.data, left_ns, took_ns, received=True) for place, each in enumerate(frames)]
        return report

    def ready_servos(self, to_feed: Mapping[int, int | None]) -> frozenset[int]:
        """Those of these servos that a power board may feed; see `Commanded.prepare`."""
        return self._commanded.prepare(to_feed)

    @property
    def controller_alive(self) -> bool | None:
        """Whether its answers and its heartbeats come; None: there was no time for one yet."""
        if self._silent is not None or self._device is None:
            return False
        return None if self._signs.answered_ns is None else True

    @property
    def answered_ns(self) -> int | None:
        """When its last well-formed answer came."""
        return self._signs.answered_ns

    def silent(self, now_ns: int) -> ControllerSilentError | None:
        """Why the controller counts as silent, once: the first time, it is shut down here.

        One that restarted, and does not come back, is silent after that. To be called often: where this process was
        delayed, what came meanwhile is not read yet.
        """
        delayed_ns, self._looked_ns = now_ns - self._looked_ns, now_ns
        if self._device is None or type(self._silent) is ControllerSilentError or delayed_ns >= self._silent_ns:
            return None
        why = self._signs.silent(now_ns)
        return None if why is None else self._is_lost(ControllerSilentError(why))

    def _is_lost(self, fault: ControllerSilentError) -> ControllerSilentError:
        self._silent = fault
        self.errors += 1
        self._shut_down_at_once()
        return fault

    def stop_servos_at_work(self) -> bool | None:
        return None if self._device is None else self._device.stop_servos_at_work()

    def put_right(self) -> str | None:
        """Not during a transfer: the kernel makes a request for a setting wait for its end, and a Stop with it."""
        return None if self._device is None or self._exchanging else self._device.put_right()

    def release(self) -> None:
        """Release the SPI device, but for a silent controller's, from which its signs of life would come.

        A UART at fault was released when it failed; one that is not is needed for the next shutdown.
        """
        if self._silent is None or self._device_failed:
            self._release_device()

    def close(self) -> None:
        self._drop_uart()
        self._release_device()

    # ---- for the cycle

    def begin_cycle(self, now_ns: int) -> bytes | None:
        """The frame that is to be exchanged now; None: none is."""
        if self._device is None or now_ns < self._frames_ns:
            return None
        frame = self._commanded.frame()
        try:
            elkapod.angles_of(frame)
        except ValueError as error:  # the encoder makes no such frame, and the controller checks nothing
            raise IllegalTransferError(str(error)) from error
        self._exchanging = True
        return frame

    def exchange(self, frame: bytes) -> bytes:
        """One transfer, for the cycle's thread, without the state. Raises SpiError."""
        device = self._device
        if device is None:
            raise SpiError("the SPI device is closed")
        return device.exchange(frame)

    def end_cycle(self, answer: bytes, took_ns: int, now_ns: int) -> Measured | None:
        """The transfer has ended well: take the answer, and return what follows the frame. Raises SpiError.

        A controller that has restarted is not started by what was meant for it before.
        """
        if self._was_abandoned():
            return None
        self.frames += 1
        self.transfer_latency.record(took_ns)
        measured, message = self._signs.answered(answer, now_ns), self._commanded.left()
        try:
            if self._uart is not None:
                self._signs.receive(self._uart.read(), now_ns)
                if message is not None and not self._signs.restarted:
                    self._uart.write(message)
        except SpiError:
            self.errors += 1
            self._drop_uart()
            raise
        if self._signs.restarted:
            raise self._has_restarted()
        return measured

    def _has_restarted(self) -> ControllerRestartedError:
        """Shut down, unless it was lost already, and let its signs of life begin anew."""
        fault = ControllerRestartedError(f"the controller may have restarted: {self._signs.restarted}")
        self._signs = self._signs.anew()
        if self._silent is None:
            self._is_lost(fault)
        return fault

    def failed_cycle(self) -> bool:
        """The transfer has failed: shut down at once. Whether that is news: False where its device was given up."""
        if self._was_abandoned():
            return False
        self.errors += 1
        self._device_failed = True
        self._shut_down_at_once()
        return True

    def _was_abandoned(self) -> bool:
        """A transfer has ended: whether its device was to be released meanwhile, which then happens now."""
        self._exchanging = False
        if self._abandoned:
            self._abandoned = False
            self._release_device()
            return True
        return False

    def _release_device(self) -> None:
        """Not in the middle of a transfer: its descriptor could be another file's by the time the kernel takes it."""
        if self._exchanging:
            self._abandoned = True
        elif self._device is not None:
            self._device.close()
            self._device = None

    def _shut_down_at_once(self) -> None:
        if self._uart is not None:
            try:
                self._uart.write(self._commanded.shut_down())
            except SpiError:  # the service opens it anew, and that begins with a shutdown
                self._drop_uart()

    def _drop_uart(self) -> None:
        if self._uart is not None:
            self._uart.close()
            self._uart = None
