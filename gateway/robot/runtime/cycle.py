"""The thread of a wire that exchanges a frame each cycle, with or without commands.

It owns the state before and after a transfer, not during one. Stops go over the UART, so a transfer that hangs delays
no Stop.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from gateway.allowance import NS_PER_S
from gateway.errors import SpiError
from gateway.host import realtime
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.spi.cyclic import CyclicBus

CYCLE_HZ: Final = 50.0
"""The rate of the robot's own driver and of the servos' PWM; a higher rate would change nothing."""
_CYCLE_NS: Final = round(NS_PER_S / CYCLE_HZ)


@dataclass
class Cycle:
    """Exchanges a frame each `1 / CYCLE_HZ` seconds, from `start` until the conductor is closed."""

    bus: CyclicBus
    conductor: Conductor
    failed: Callable[[Exception], None]
    """Called on the cycle's thread with the unexpected exception that ended it."""
    clock: Callable[[], int] = time.monotonic_ns

    def start(self) -> None:
        """Start the thread. The bus must be open."""
        threading.Thread(target=self._run, name="cycle", daemon=True).start()

    def _run(self) -> None:
        realtime.prefer_thread(realtime.LOOP_PRIORITY)
        due_ns = self.clock()
        try:
            while not self.conductor.closed:
                self.exchange()
                # A late frame is not made up for: two in a row would give the controller nothing new.
                due_ns = max(due_ns + _CYCLE_NS, self.clock())
                time.sleep(max(0, due_ns - self.clock()) / 1e9)
        except Exception as error:
            self.failed(error)

    def exchange(self) -> None:
        """Run one cycle. The caller must not own the state."""
        conductor = self.conductor
        with conductor.owner:
            frame = self.bus.begin_cycle(self.clock())
        if frame is not None:
            self._exchange(frame)
        with conductor.owner:  # after the transfer: answers that arrived while this process was delayed count
            silent = self.bus.silent(self.clock())
            if silent is not None:
                conductor.bus_failed(silent)

    def _exchange(self, frame: bytes) -> None:
        conductor = self.conductor
        begun_ns = self.clock()
        try:
            answer = self.bus.exchange(frame)
        except SpiError as fault:
            with conductor.owner:
                if self.bus.failed_cycle():
                    conductor.bus_failed(fault)
            return
        with conductor.owner:
            now_ns = self.clock()
            try:
                measured = self.bus.end_cycle(answer, now_ns - begun_ns, now_ns)
            except SpiError as fault:
                conductor.bus_failed(fault)
                return
            if measured is not None:
                conductor.measured(measured, now_ns)
