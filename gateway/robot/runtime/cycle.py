"""The thread of a wire that exchanges a frame each cycle, with or without commands.

It owns the state before and after a transfer, not during one. Stops go over the UART, so a transfer that hangs delays
no Stop.
"""

import threading
import time
from collections.abc import Callable
from typing import Final

from gateway.allowance import NS_PER_S
from gateway.errors import SpiError
from gateway.host import realtime
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.spi.cyclic import CyclicBus

CYCLE_HZ: Final = 50.0
"""The rate of the robot's own driver and of the servos' PWM; a higher rate would change nothing."""


class Cycle:
    """Exchanges a frame each `1 / CYCLE_HZ` seconds, from `start` until the conductor is closed."""

    def __init__(
        self,
        bus: CyclicBus,
        conductor: Conductor,
        failed: Callable[[Exception], None],
        *,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """`failed` is called on the cycle's thread with the unexpected exception that ended it."""
        self._bus = bus
        self._conductor = conductor
        self._cycle_ns = round(NS_PER_S / CYCLE_HZ)
        self._failed = failed
        self._clock = clock
        self._thread = threading.Thread(target=self._run, name="cycle", daemon=True)

    def start(self) -> None:
        """Start the thread. The bus must be open."""
        self._thread.start()

    def _run(self) -> None:
        realtime.prefer_thread(realtime.LOOP_PRIORITY)
        due_ns = self._clock()
        try:
            while not self._conductor.closed:
                self.exchange()
                # A late frame is not made up for: two in a row would give the controller nothing new.
                due_ns = max(due_ns + self._cycle_ns, self._clock())
                time.sleep(max(0, due_ns - self._clock()) / 1e9)
        except Exception as error:
            self._failed(error)

    def exchange(self) -> None:
        """Run one cycle. The caller must not own the state."""
        conductor = self._conductor
        with conductor.owner:
            frame = self._bus.begin_cycle(self._clock())
        if frame is not None:
            self._exchange(frame)
        with conductor.owner:  # after the transfer: answers that arrived while this process was delayed count
            silent = self._bus.silent(self._clock())
            if silent is not None:
                conductor.bus_failed(silent)

    def _exchange(self, frame: bytes) -> None:
        conductor = self._conductor
        begun_ns = self._clock()
        try:
            answer = self._bus.exchange(frame)
        except SpiError as fault:
            with conductor.owner:
                if self._bus.failed_cycle():
                    conductor.bus_failed(fault)
            return
        with conductor.owner:
            now_ns = self._clock()
            try:
                measured = self._bus.end_cycle(answer, now_ns - begun_ns, now_ns)
            except SpiError as fault:
                conductor.bus_failed(fault)
                return
            if measured is not None:
                conductor.measured(measured, now_ns)
