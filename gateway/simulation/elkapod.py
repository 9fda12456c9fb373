"""A simulated controller with `elkapod-2025`: SPI in full duplex, a UART, 18 servos and sensors.

Its firmware is not published. Known behaviour (docs/protocol.md):

* A transfer of 80 bytes from 7E to 0F sends all servos to its angles; any other transfer changes nothing.
* Each transfer returns the measurement prepared at the transfer before; the first one after power-up returns garbage.
* START on the UART drives all servos to the newest frame's angles, SHUTDOWN makes all slack. Neither is answered. Other
  bytes are skipped.
* It sends a heartbeat every 50 ms.

Unknown behaviour is simulated as the most harmful one:

* If frames stop, the last angles hold forever.
* Angles are not checked. A servo stops at the end of its range, and an angle that is not a number leaves its target.
  Both are counted in `corruptions`, and so is a START before any frame: here the servos then wait for the first frame.

Measurements are from the simulated body, if there is one; after the end of its process they stay constant. Without a
body the robot is at rest and level, and servos draw current while they move. Each foot carries a sixth of the assumed
weight while servos are driven, and nothing while they are slack. The sensors are noisy, so no two answers are equal.
The unit of forces on this wire is not documented; here it is the newton.
"""

import collections
import math
import random
import re
import struct
import threading
import time
from collections.abc import Callable
from typing import Final

from gateway.geometry.kinematics import Vector
from gateway.geometry.model import TOTAL_KG
from gateway.host.shared_page import Sensed, SensedPage, ServoPage
from gateway.model import elkapod
from gateway.model.elkapod import BEGIN, END, FRAME_BYTES, SHUTDOWN, START, Measured
from gateway.model.servo import A_PER_NM, IDLE_A, MOVING_A
from gateway.robot.spi import DuplexDevice
from gateway.simulation.controller import SimulatedServos
from schemas.robot import LEGS, SERVO_IDS

FULL_V: Final = 8.4
EMPTY_V: Final = 6.4
"""Two cells at rest: full at 4.2 V each, and switched off at 3.2 V each."""
RESISTANCE_OHM: Final = 0.06
"""The resistance of the pack, its plug and its wires."""
CAPACITY_AS: Final = 5.0 * 3600

BASE_A: Final = 1.0
"""The computer and the controller, without servos."""


HEARTBEAT_NS: Final = 50_000_000
MOST_HEARTBEATS: Final = 4096 // elkapod.HEARTBEAT_BYTES
"""The heartbeats that a terminal's buffer holds. Further ones are lost."""
GARBAGE: Final = bytes(range(FRAME_BYTES))
"""The first answer after power-up. Only its first byte shows that it is no measurement."""

_ANGLES: Final = struct.Struct(f"<{len(SERVO_IDS)}f")
_MESSAGE: Final = re.compile(b"|".join(map(re.escape, (START, SHUTDOWN))))
_LONGEST: Final = max(len(START), len(SHUTDOWN))
_GRAVITY_M_S2: Final = 9.81
_AMBIENT_C: Final = 25.0
_WARMS_BY_C: Final = 15.0
_WARMS_IN_S: Final = 900.0
_GYRO_NOISE_RAD_S: Final = 0.002
_ACCELEROMETER_NOISE_M_S2: Final = 0.02


class SimulatedElkapod(DuplexDevice):
    """The controller with its UART, its servos and its battery. Thread-safe; each call takes microseconds."""

    def __init__(
        self,
        *,
        clock: Callable[[], int] = time.monotonic_ns,
        on_change: Callable[[str], None] | None = None,
        page: ServoPage | None = None,
        sensed: SensedPage | None = None,
    ) -> None:
        """Switched on now, servos slack. `clock` returns ns. `on_change` gets a line on each change.

        `page` gets the targets, and contains which servos a power board powers. `sensed` is a simulated body's sensors.
        """
        self.corruptions: collections.Counter[str] = collections.Counter()
        self._clock = clock
        self._say = on_change or (lambda _: None)
        self._sensed = sensed
        self._charge, self._drawn_a = 1.0, BASE_A
        """Of the battery: from 1, full, to 0."""
        self._noise = random.Random(0)  # noqa: S311  (sensor noise, no secrets)
        self._lock = threading.Lock()
        now_ns = clock()
        self._begun_ns = self._advanced_ns = self._beat_ns = now_ns
        self._servos = SimulatedServos(now_ns, page)
        self._answer = GARBAGE
        self._received = b""

    # ---- the wires

    def exchange(self, data: bytes) -> bytes:
        """Make one transfer. Return as many bytes as `data` has."""
        with self._lock:
            now_ns = self._clock()
            self._advance(now_ns)
            if len(data) == FRAME_BYTES and data[0] == BEGIN and data[-1] == END:
                self._take(_ANGLES.unpack_from(data, 1))
            answer, self._answer = self._answer, elkapod.answer(self._measure(now_ns))
        return answer[: len(data)].ljust(len(data), b"\0")

    def write(self, data: bytes) -> None:
        """Receive bytes on the UART, in portions of any length."""
        with self._lock:
            self._advance(self._clock())
            self._received += data
            end = 0
            for found in _MESSAGE.finditer(self._received):
                self._obey(found[0])
                end = found.end()
            self._received = self._received[end:][1 - _LONGEST :]

    def read(self) -> bytes:
        """Return the bytes that the controller has sent on the UART since the last call."""
        with self._lock:
            due = max(0, (self._clock() - self._beat_ns) // HEARTBEAT_NS)
            self._beat_ns += due * HEARTBEAT_NS
            return elkapod.heartbeat() * min(due, MOST_HEARTBEATS)

    def close(self) -> None:
        """Change nothing: the controller and its servos stay on."""

    # ---- the firmware

    def _take(self, angles_deg: tuple[float, ...]) -> None:
        changes = []
        for (servo_id, servo), angle_deg in zip(self._servos.items(), angles_deg, strict=True):
            if not 0 <= angle_deg <= 180:
                self.corruptions[f"servo {servo_id} was sent to {angle_deg:g}°"] += 1
            before_deg = servo.target_deg
            if not math.isnan(angle_deg):
                self._servos.send(servo_id, angle_deg, start=False)
            if servo.energised and servo.target_deg != before_deg:
                changes.append(f"servo {servo_id} set to {angle_deg:.2f}°")
        if changes:
            self._say("; ".join(changes))

    def _obey(self, message: bytes) -> None:
        if message == SHUTDOWN:
            for servo_id in self._servos:
                self._servos.stop(servo_id)
            self._say("shut down")
            return
        if any(servo.target_deg is None for servo in self._servos.values()):
            self.corruptions["started before any frame"] += 1
        for servo_id, servo in self._servos.items():
            self._servos.send(servo_id, servo.target_deg, start=True)
        self._say("started")

    # ---- what it measures

    def _advance(self, now_ns: int) -> None:
        """Move the servos and discharge the battery up to now."""
        self._servos.move(now_ns)
        body, servos = self._body(), self._servos.values()
        moving_a = MOVING_A * sum(each.driven and each.target_deg not in (None, each.angle_deg) for each in servos)
        works_a = moving_a if body is None else A_PER_NM * sum(map(abs, body.torques_nm))
        self._drawn_a = BASE_A + IDLE_A * sum(servo.driven for servo in servos) + works_a
        drawn_as = self._drawn_a * (now_ns - self._advanced_ns) / 1e9
        self._charge = max(0.0, self._charge - drawn_as / CAPACITY_AS)
        self._advanced_ns = now_ns

    def _measure(self, now_ns: int) -> Measured:
        foot_n = TOTAL_KG * _GRAVITY_M_S2 / len(LEGS) if any(servo.driven for servo in self._servos.values()) else 0.0
        rest = Sensed((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, _GRAVITY_M_S2), (foot_n,) * len(LEGS), ())
        body = self._body() or rest
        one, two, three, four, five, six = body.feet_n
        passed_s = (now_ns - self._begun_ns) / 1e9
        voltage_v = EMPTY_V + (FULL_V - EMPTY_V) * self._charge - RESISTANCE_OHM * self._drawn_a
        return Measured(
            temperature_c=_AMBIENT_C + _WARMS_BY_C * (1 - math.exp(-passed_s / _WARMS_IN_S)),
            voltage_v=voltage_v,
            # Estimated from the voltage, as simple boards do: it falls under load, and recovers.
            percent=max(0.0, min(100.0, 100 * (voltage_v - EMPTY_V) / (FULL_V - EMPTY_V))),
            orientation_wxyz=body.orientation_wxyz,
            angular_velocity_rad_s=self._noisy(body.angular_velocity_rad_s, _GYRO_NOISE_RAD_S),
            linear_acceleration_m_s2=self._noisy(body.linear_acceleration_m_s2, _ACCELEROMETER_NOISE_M_S2),
            feet=(one, two, three, four, five, six),
        )

    def _noisy(self, vector: Vector, deviation: float) -> Vector:
        x, y, z = (self._noise.gauss(each, deviation) for each in vector)
        return x, y, z

    def _body(self) -> Sensed | None:
        return None if self._sensed is None else self._sensed.read()
