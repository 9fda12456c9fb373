"""The simulated controllers, with what a person at one sees and does; and the transfers on the wire."""

import random
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from gateway.errors import SpiError
from gateway.model.frames import Frame, Framing
from gateway.simulation.controller import SimulatedController, SimulatedServos
from gateway.simulation.elkapod import GARBAGE, SimulatedElkapod


def _power_cycle(servos: SimulatedServos) -> None:
    """Switch all servos off. They know no angle afterwards."""
    for servo_id, servo in servos.items():
        servo.target_deg = servo.pulse_us = None
        servos.stop(servo_id)


KEPT_TRANSFERS = 10_000  # the newest; 33 s of six legs at 50 Hz


class Controller(SimulatedController):
    """A simulated controller of HexapodProtocol v1.0.0."""

    def __init__(self, framing: Framing, **options: Any) -> None:
        super().__init__(framing, **options)
        self.transfers = deque[tuple[int, bytes]](maxlen=KEPT_TRANSFERS)

    def take(self, data: bytes) -> None:
        self.transfers.append((self._clock(), data))
        super().take(data)

    @property
    def servos(self) -> SimulatedServos:
        """Return the servos in their current state."""
        now_ns = self._clock()
        self._expire_receive(now_ns)
        self._servos.move(now_ns)
        return self._servos

    @property
    def energised(self) -> frozenset[int]:
        """Return the ids of the servos whose PWM output is on now."""
        return frozenset(servo_id for servo_id, servo in self.servos.items() if servo.energised)

    @property
    def missing(self) -> int:
        """Return the bytes of a body that it still awaits, or 0 if it awaits a length."""
        self._expire_receive(self._clock())
        return self._body_len - len(self._body)

    def reset(self) -> None:
        """Press its reset button: it awaits a length, and all servos are off."""
        self.dead = None
        self._body.clear()
        self._body_len = 0
        self._servos.move(self._clock())
        _power_cycle(self._servos)


class Elkapod(SimulatedElkapod):
    """A simulated controller of elkapod-2025."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.transfers = deque[tuple[int, bytes]](maxlen=KEPT_TRANSFERS)
        """The newest on SPI, with their times."""
        self.messages = deque[tuple[int, bytes]](maxlen=KEPT_TRANSFERS)
        """The newest START and SHUTDOWN on the UART, with their times."""
        self.silent = False
        """No heartbeats."""
        self.frozen = False
        """Each answer repeats the previous one."""
        self.garbage: bytes | None = None
        """These bytes in place of each measurement."""
        self.spi_fails = False
        """Each transfer fails."""
        self._on_ns = 0

    def exchange(self, data: bytes) -> bytes:
        if self.spi_fails:
            raise SpiError("the transfer failed: Connection timed out")
        self.transfers.append((self._clock(), data))
        if self._clock() < self._on_ns:
            return bytes(len(data))
        before, answer = self._answer, super().exchange(data)
        if self.garbage is not None or self.frozen:
            self._answer = self.garbage or before
        return answer

    def write(self, data: bytes) -> None:
        if self._clock() >= self._on_ns:
            super().write(data)

    def read(self) -> bytes:
        return b"" if self.silent else super().read()

    def _obey(self, message: bytes) -> None:
        self.messages.append((self._clock(), message))
        super()._obey(message)

    @property
    def servos(self) -> SimulatedServos:
        """Return the servos in their current state."""
        with self._lock:
            self._advance(self._clock())
            return self._servos

    @property
    def energised(self) -> frozenset[int]:
        """Return the ids of the servos that are driven now: all or none."""
        return frozenset(servo_id for servo_id, servo in self.servos.items() if servo.energised)

    def power_cycle(self, *, off_ns: int = 0, first_answer: bytes = GARBAGE) -> None:
        """Switch it off, and on after `off_ns`: servos slack, and all angles forgotten.

        Meanwhile it hears nothing, sends no heartbeat, and MISO is low.
        """
        with self._lock:
            now_ns = self._clock()
            self._advance(now_ns)
            _power_cycle(self._servos)
            self._on_ns = self._beat_ns = now_ns + off_ns
            self._answer, self._received = first_answer, b""
            self._say("it was switched off and on")


class FaultyController(Controller):
    """A controller with faults, each from when it is asked for. It sees no byte of a transfer that fails."""

    def __init__(
        self,
        framing: Framing,
        *,
        clock: Callable[[], int] = time.monotonic_ns,
        spend: Callable[[float], None] = time.sleep,
    ) -> None:
        """Make one. `spend`: lets a failing transfer take so many seconds."""
        super().__init__(framing, clock=clock)
        self._spend = spend
        self._fails: Callable[[bytes], bool] = lambda _: False
        self._cost_ms = self._stall_ms = 0.0
        self._failing_transfers = 0
        self._failing_until_ns = clock()
        self.all_off_ns: int | None = None
        """When the last servo was switched off, since a test set this to None."""

    def fail_next(self, count: int) -> None:
        self._failing_transfers = count

    def fail_for_ms(self, duration_ms: float) -> None:
        self._failing_until_ns = self._clock() + round(duration_ms * 1e6)

    def fail_where(self, fails: Callable[[bytes], bool], cost_ms: float = 0.0) -> None:
        """Let each transfer for which `fails` is true raise SpiError, after this time."""
        self._fails, self._cost_ms = fails, cost_ms

    def fail_by_chance(self, share: float, seed: int, cost_ms: float = 0.0) -> None:
        """Let each transfer fail with this probability, after this time."""
        chance = random.Random(seed)  # noqa: S311  (faults, no secrets)
        self.fail_where(lambda _: chance.random() < share, cost_ms)

    def stall_once(self, cost_ms: float) -> None:
        """Let the next transfer take this time, and succeed."""
        self._stall_ms = cost_ms

    def take(self, data: bytes) -> None:
        if self._stall_ms:
            cost_ms, self._stall_ms = self._stall_ms, 0.0
            self._spend(cost_ms / 1000)
        if self._fails(data):
            self._spend(self._cost_ms / 1000)
            raise SpiError("the simulated SPI device failed a transfer")
        if self._failing_transfers > 0 or self._clock() < self._failing_until_ns:
            self._failing_transfers = max(0, self._failing_transfers - 1)
            raise SpiError("the simulated SPI device failed a transfer")
        super().take(data)
        if self.all_off_ns is None and not self.energised:
            self.all_off_ns = self._clock()


def on_wire(framing: Framing, *frames: Frame | bytes) -> list[bytes]:
    """Return the transfers that carry these frames, in order: where the framing wants it, each behind its length."""
    written = [frame if isinstance(frame, bytes) else frame.data for frame in frames]
    announced = framing is Framing.LENGTH_PREFIXED
    return [data for frame in written for data in ((bytes((len(frame),)), frame) if announced else (frame,))]


def preamble_of(framing: Framing) -> list[bytes]:
    """Return the zeros that synchronise a controller, each in a transfer of its own; none for PLAIN."""
    return [b"\0"] * 16 if framing is Framing.LENGTH_PREFIXED else []
