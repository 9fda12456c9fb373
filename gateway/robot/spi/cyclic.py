"""The wire of elkapod-2025 as the service sees it: a frame each cycle over SPI, and starts and Stops over a UART.

Neither way waits for the other. Stops are one UART message, sent at once, so a transfer that takes 300 ms to fail
delays none. A thread of its own exchanges frames (`run_cycles`), and owns the state only between two transfers. A
step's targets are in the next frame. Its starts follow over the UART once their angles were on the wire
(`protocol.elkapod.Commanded`).

If SPI fails, or the controller falls silent or restarts, the UART sends shut down at once, before any report of it.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from typing import Final

from gateway.errors import ControllerRestartedError, ControllerSilentError, SpiError
from gateway.host import realtime
from gateway.model.elkapod import Measured
from gateway.model.frames import STOP_REPEAT_MS, STOP_REPEATS, Frame
from gateway.rate_limit import NS_PER_MS, NS_PER_S
from gateway.robot.protocol.elkapod import SILENT_NS, Commanded, SignsOfLife
from gateway.robot.spi import BatchReport, DuplexDevice, Sent, Wire
from gateway.robot.spi.uart import Uart

CYCLE_HZ: Final = 50.0
"""The rate of the robot's own driver and of the servos' PWM; a higher rate would change nothing."""
BEFORE_FRAMES_NS: Final = round((STOP_REPEATS + 0.5) * STOP_REPEAT_MS * NS_PER_MS)
"""For this long after an opening no frame is sent: it would move servos whose shutdown was lost, and the shutdown is
repeated meanwhile."""


def run_cycles(cycle: Callable[[], None], clock: Callable[[], int] = time.monotonic_ns) -> None:
    """Call `cycle` each `1 / CYCLE_HZ` seconds until the process ends. For a thread of its own."""
    realtime.prefer_thread(realtime.LOOP_PRIORITY)
    due_ns = clock()
    while True:
        cycle()
        # A late frame is not made up for: two in a row would give the controller nothing new.
        now_ns = clock()
        due_ns = max(due_ns + round(NS_PER_S / CYCLE_HZ), now_ns)
        time.sleep((due_ns - now_ns) / 1e9)


class CyclicBus(Wire):
    """Sends the frames of steps. For the owner of the state, except `cycle`."""

    # mutants accepted (Forget, Step): opening sets it; the service states all
    def __init__(
        self,
        open_device: Callable[[], DuplexDevice] | None,
        open_uart: Callable[[], Uart],
        *,
        fed_singly: bool = False,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """`open_device` is None if only Stops are written (`stop-servos`).

        `fed_singly`: a power board starts and stops each servo by its supply.
        """
        super().__init__()
        self._open_device = open_device
        self._open_uart = open_uart
        self._clock = clock
        self._device: DuplexDevice | None = None
        self._uart: Uart | None = None
        self._commanded = Commanded(fed_singly=fed_singly)
        self._signs = SignsOfLife(0)
        self._silent: ControllerSilentError | None = None
        self._frames_ns = 0  # when frames begin
        self._checked_ns = 0  # when `silent` was last called
        self._exchanging = False

    # ---- for the service

    def ready_servos(self, servos: Mapping[int, int | None]) -> frozenset[int]:
        """Return those of these servos that a power board may power; see `Commanded.prepare`."""
        return self._commanded.prepare(servos)

    def open(self) -> None:
        """Open UART and device if they are closed, and shut down. Raises SpiError, also for a silent controller."""
        try:
            if self._uart is None:
                self._uart = self._open_uart()
            self._say(self._commanded.shut_down())  # independently of SPI
            if self._device is None and self._open_device is not None:
                self._device = self._open_device()
                self._frames_ns = self._clock() + BEFORE_FRAMES_NS
                self._signs = SignsOfLife(self._frames_ns)
        except SpiError:
            self.errors += 1
            raise
        if self._silent is not None:
            if not self._signs.alive(self._clock()):
                raise self._silent
            self._silent = None

    # mutants accepted (FalseWithTrue, Step): all stop, or none; no preamble is needed
    def write(self, frames: Sequence[Frame], *, preamble: bool = False) -> BatchReport:  # noqa: ARG002
        """Send a Stop over the UART, or take targets for the next frame. Return what was sent."""
        report, begun_ns, stops = BatchReport(), self._clock(), frames[0].is_stop
        try:
            if self._device is None and not stops:
                raise SpiError("the SPI device is closed")
            if not stops:
                self._commanded.take(frames)
            elif message := self._commanded.stop([servo_id for frame in frames for servo_id, _ in frame.servos]):
                self._say(message)
        except SpiError as fault:
            self.errors += 1
            report.fault = fault
            return report
        now_ns = self._clock()
        report.sent.append(Sent(0, len(frames), now_ns, now_ns - begun_ns, received=True))
        return report

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
        if self._device is None or type(self._silent) is ControllerSilentError or delayed_ns >= SILENT_NS:
            return None
        why = self._signs.silent(now_ns)
        return None if why is None else self._is_lost(ControllerSilentError(why))

    def _is_lost(self, fault: ControllerSilentError) -> ControllerSilentError:
        self._silent = fault
        self.errors += 1
        self._shut_down_at_once()
        return fault

    def put_right(self) -> str | None:
        """As in `Wire`, but not during a transfer: the kernel would make this call, and a Stop, wait for its end."""
        return None if self._exchanging else super().put_right()

    def release(self) -> None:
        """Release the SPI device, unless the controller is silent: its signs of life would come over the device.

        A failed UART is already released; a working one is needed for the next shutdown.
        """
        if self._silent is None:
            self._release_device()

    def close(self) -> None:
        self._drop_uart()
        self._release_device()

    # ---- the cycle

    def cycle(
        self,
        owner: AbstractContextManager[None],
        measured: Callable[[Measured, int], None],
        failed: Callable[[SpiError], None],
    ) -> None:
        """Exchange a frame, with or without commands. For the cycle's thread.

        `owner` is the state's lock. `measured` is called with a measurement and its time, `failed` with a fault, both
        with the state owned. A device that was released during its transfer is closed after it: before, its descriptor
        could become another file's. Raises ValueError for illegal angles, a bug of the gateway.
        """
        with owner:
            device, begun_ns = self._device, self._clock()
            frame = self._commanded.frame() if device is not None and begun_ns >= self._frames_ns else None
            self._exchanging = frame is not None
        if device is not None and frame is not None:
            answer: bytes | SpiError
            try:
                answer = device.exchange(frame)
            except SpiError as error:
                answer = error
            with owner:
                self._exchanging, now_ns = False, self._clock()
                if device is not self._device:
                    device.close()
                    return
                found = self._take(answer, now_ns - begun_ns, now_ns)
                if isinstance(found, SpiError):
                    failed(found)
                elif found is not None:
                    measured(found, now_ns)
        with owner:  # after the transfer: answers that arrived while this process was delayed count
            silent = self.silent(self._clock())
            if silent is not None:
                failed(silent)

    def _take(self, answer: bytes | SpiError, took_ns: int, now_ns: int) -> Measured | SpiError | None:
        """Take a transfer's answer, and send the message that was due after its frame. Return any measurements, or the
        fault of the transfer, of the UART or of a restarted controller, which gets no earlier message."""
        if isinstance(answer, SpiError):
            self.errors += 1
            self._shut_down_at_once()
            self._release_device()
            return answer
        self.frames += 1
        self.transfer_latency.record(took_ns)
        measured, message = self._signs.answered(answer, now_ns), self._commanded.left()
        try:
            if self._uart is not None:
                self._signs.receive(self._uart.read(), now_ns)
                if message is not None and not self._signs.restarted:
                    self._uart.write(message)
        except SpiError as fault:
            self.errors += 1
            self._drop_uart()
            return fault
        if self._signs.restarted:
            restart = ControllerRestartedError(f"the controller may have restarted: {self._signs.restarted}")
            self._signs = self._signs.anew()
            return restart if self._silent is not None else self._is_lost(restart)
        return measured

    # ---- the devices

    def _say(self, message: bytes) -> None:
        """Write a message to the UART; close the UART if it fails. Raises SpiError."""
        if self._uart is None:
            raise SpiError("the UART is closed")
        try:
            self._uart.write(message)
        except SpiError:
            self._drop_uart()
            raise

    def _shut_down_at_once(self) -> None:
        with suppress(SpiError):  # the service reopens the UART, which begins with a shutdown
            self._say(self._commanded.shut_down())

    def _release_device(self) -> None:
        device, self._device = self._device, None
        if device is not None and not self._exchanging:
            device.close()

    def _drop_uart(self) -> None:
        if self._uart is not None:
            self._uart.close()
            self._uart = None
