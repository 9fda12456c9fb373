"""The wire of elkapod-2025 as the service sees it: a frame each cycle over SPI, and starts and Stops over a UART.

Neither way waits for the other. Stops are one UART message, sent at once, so a transfer that takes 300 ms to fail
delays none. The cycle's thread (`runtime.cycle`) exchanges frames, and owns the state only between two transfers. A
step's targets are in the next frame. Its starts follow over the UART once their angles were on the wire
(`protocol.elkapod.Commanded`).

If SPI fails, or the controller falls silent or restarts, the UART sends shut down at once, before any report of it.
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
"""A byte has one start bit, eight data bits and two stop bits."""
MESSAGE_NS: Final = len(SHUTDOWN) * _UART_BITS * NS_PER_S // UART_BAUD
"""A message's time on the UART: 95 µs."""


class CyclicBus(Wire):
    """Sends the frames of steps. For the owner of the state, except `exchange`: for the cycle's thread, without it."""

    # mutants accepted (Forget, Step): opening sets it; the service states all
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
        """`open_device` is None if only Stops are written (`stop-servos`).

        For `before_frames_ns` after an opening no frame is sent: it would move servos whose shutdown was lost, and the
        shutdown is repeated meanwhile. `fed_singly`: a power board starts and stops each servo by its supply.
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
        self._frames_ns = 0  # when frames begin
        self._checked_ns = 0  # when `silent` was last called
        self._device_failed = self._exchanging = self._abandoned = False
        self.frames = 0
        self.errors = 0
        self.ended_ns = 0
        self.transfer_latency = Latency()

    # ---- for the service

    def open(self) -> None:
        """Open UART and device if they are closed, and shut down. Raises SpiError, also for a silent controller."""
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
        """Open the UART and shut down over it, independently of SPI. Raises SpiError."""
        if self._uart is None:
            self._uart = self._open_uart()
        try:
            self._uart.write(self._commanded.shut_down())
        except SpiError:
            self._drop_uart()
            raise
        if self._abandoned:
            raise SpiError("the transfer in progress has not ended")

    # mutants accepted (FalseWithTrue, Step): all stop, or none; no preamble is needed
    def write(self, frames: Sequence[Frame], *, preamble: bool = False) -> BatchReport:  # noqa: ARG002
        """Send a Stop over the UART, or take targets for the next frame. Return what was sent."""
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
        """Return those of these servos that a power board may power; see `Commanded.prepare`."""
        return self._commanded.prepare(to_feed)

    @property
    def controller_alive(self) -> bool | None:
        """Whether the controller sends answers and heartbeats; None: no time for one yet."""
        if self._silent is not None or self._device is None:
            return False
        return None if self._signs.answered_ns is None else True

    @property
    def answered_ns(self) -> int | None:
        return self._signs.answered_ns

    def silent(self, now_ns: int) -> ControllerSilentError | None:
        """Return why the controller counts as silent, and shut it down; None if it does not, or was already reported.

        A restarted controller that does not return is silent, too. Call this often: after a long gap this process was
        delayed, and answers may be unread, so the controller does not count as silent.
        """
        delayed_ns, self._checked_ns = now_ns - self._checked_ns, now_ns
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
        """As in `Wire`, but not during a transfer: the kernel would make this call, and a Stop, wait for its end."""
        return None if self._device is None or self._exchanging else self._device.put_right()

    def release(self) -> None:
        """Release the SPI device, unless the controller is silent: its signs of life would come over the device.

        A failed UART is already released; a working one is needed for the next shutdown.
        """
        if self._silent is None or self._device_failed:
            self._release_device()

    def close(self) -> None:
        self._drop_uart()
        self._release_device()

    # ---- for the cycle

    def begin_cycle(self, now_ns: int) -> bytes | None:
        """Return the frame to exchange now, or None. Raises IllegalTransferError for a frame with illegal angles."""
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
        """Exchange a frame and return the answer. For the cycle's thread, without the state. Raises SpiError."""
        device = self._device
        if device is None:
            raise SpiError("the SPI device is closed")
        return device.exchange(frame)

    def end_cycle(self, answer: bytes, took_ns: int, now_ns: int) -> Measured | None:
        """Take a transfer's answer and send the messages that were due after its frame. Return the measurements.

        A restarted controller gets no earlier message. Raises SpiError if the UART fails or the controller restarted.
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
        """Shut down, unless the controller was lost already, and expect new signs of life."""
        fault = ControllerRestartedError(f"the controller may have restarted: {self._signs.restarted}")
        self._signs = self._signs.anew()
        if self._silent is None:
            self._is_lost(fault)
        return fault

    def failed_cycle(self) -> bool:
        """Shut down after a failed transfer. Return whether to report it: False if its device was already given up."""
        if self._was_abandoned():
            return False
        self.errors += 1
        self._device_failed = True
        self._shut_down_at_once()
        return True

    def _was_abandoned(self) -> bool:
        """After a transfer: if its device had to be released meanwhile, release it and return True."""
        self._exchanging = False
        if self._abandoned:
            self._abandoned = False
            self._release_device()
            return True
        return False

    def _release_device(self) -> None:
        """Release the device, after a transfer in progress: its descriptor could become another file's meanwhile."""
        if self._exchanging:
            self._abandoned = True
        elif self._device is not None:
            self._device.close()
            self._device = None

    def _shut_down_at_once(self) -> None:
        if self._uart is not None:
            try:
                self._uart.write(self._commanded.shut_down())
            except SpiError:  # the service reopens the UART, which begins with a shutdown
                self._drop_uart()

    def _drop_uart(self) -> None:
        if self._uart is not None:
            self._uart.close()
            self._uart = None
