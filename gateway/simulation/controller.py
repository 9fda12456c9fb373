"""A simulated controller: it reads raw bytes as the published STM32F446 firmware does, and moves 18 simulated servos.

It behaves like that firmware (docs/protocol.md):

* `length-prefixed` is the firmware: it reads one byte as a length, awaits that many bytes, and then handles them.
  `plain` is a controller that follows the document: byte 1 is FRAME LEN and belongs to the frame.
* Chip select means nothing: bytes are one stream, so a lost byte misaligns everything after it, until a pause.
* A frame is executed if its type (byte 2) fits the length received. Byte 1 and the servo ids are not checked.
* A receive times out after 1000 ms. The firmware counts ticks of a millisecond (HAL_GetTick), from the tick in which
  the length arrived to the thousandth after it: 999 to 1000 ms. `tick_phase_ns` is the part of a tick that had passed
  at time 0 of the clock. The published firmware then executes the bytes received, with zeros for the rest, so half of
  a ONE SERVO Start starts its servo. The controller that follows the document drops them.
* A length over 64 overruns the receive buffer, and an id may index past the servo table: counted in `corruptions`.
* The firmware dies (`dead`) of a record with an operation whose id has the table index 252 to 255 (ids 0 to 3 and 10):
  a bus fault. It also dies of a 69th byte in its receive buffer: bytes 65 to 68 do no harm, the SPI handle lies after
  them. All measured builds do both (-Og, -Ofast, -O0 hard and soft float, -Os). A dead firmware receives nothing until
  it is reset, and its running servos stay energised. The controller that follows the document does not die.
* Ids outside the protocol may start a real servo. An index within the table drives that entry's servo, as in every
  build (id 14 drives servo 21). Two entries past the table drive a servo as in the -Og build (ids 64 and 90 were
  measured: servos 11 and 21), for `length-prefixed` only. Ids with the same index drive the same servo here.

Not simulated, so that the firmware may do worse:

* The other entries past the table touch nothing here. In the firmware, 118 to 132 of the 199 ids outside the table end
  in a fault, depending on the build, some leave it deaf, and many others start a real servo.
* Bytes, frames and lengths of 0 take no time. The firmware misses bytes that arrive while it handles others, such as
  zeros within one transfer. So a stream that is out of sync loses more bytes there, and kills it more often
  (docs/protocol.md has both figures).
* Bits: a lost or added clock edge would misalign everything after it, until a reset.
"""

import collections
import functools
import math
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from gateway.host.shared_page import ServoPage
from gateway.model.frames import ONE_LEG_LEN, ONE_LEG_TYPE, ONE_SERVO_LEN, ONE_SERVO_TYPE, Framing, Op
from gateway.model.servo import NO_LOAD_DEG_S
from gateway.robot.spi import Batch, SpiDevice
from schemas.robot import SERVO_IDS


@dataclass(slots=True)
class ServoState:
    """One servo: PWM output on or off, its target (None before the first), and its horn's angle, 0° to 180°."""

    energised: bool = False
    target_deg: float | None = None
    angle_deg: float = 90.0  # assumed: before a servo is first energised, its horn may stand anywhere
    pulse_us: int | None = None  # None: its controller computes none
    fed: bool = True  # until a simulated power board reports otherwise

    @property
    def driven(self) -> bool:
        """Whether it drives to its target: its output is on, and it has supply."""
        return self.energised and self.fed


class SimulatedServos(dict[int, ServoState]):
    """The 18 servos by id. Times are of one monotonic clock."""

    def __init__(self, now_ns: int, page: ServoPage | None) -> None:
        """All off. `page` gets each target, and contains which servos are powered; None: all are."""
        super().__init__((servo_id, ServoState()) for servo_id in SERVO_IDS)
        self._page = page
        self._moved_ns = now_ns

    def send(self, servo_id: int, target_deg: float | None, *, start: bool) -> None:
        """Set a target, limited to 0° to 180°; None: none. A servo that is off stays off unless `start`."""
        servo = self[servo_id]
        servo.target_deg = None if target_deg is None else max(0.0, min(target_deg, 180.0))
        servo.energised = servo.energised or start
        self._show(servo_id, servo)

    def stop(self, servo_id: int) -> None:
        """Switch its output off; the horn stays."""
        self[servo_id].energised = False
        self._show(servo_id, self[servo_id])

    def move(self, now_ns: int) -> None:
        """Move the horns up to `now_ns`, at the speed without load."""
        most_deg = NO_LOAD_DEG_S * (now_ns - self._moved_ns) / 1e9
        self._moved_ns = now_ns
        fed = self.keys() if self._page is None else self._page.fed
        for servo_id, servo in self.items():
            servo.fed = servo_id in fed
            if servo.driven and servo.target_deg is not None:
                way_deg = servo.target_deg - servo.angle_deg
                far = abs(way_deg) > most_deg
                servo.angle_deg = servo.angle_deg + math.copysign(most_deg, way_deg) if far else servo.target_deg

    def _show(self, servo_id: int, servo: ServoState) -> None:
        if self._page is not None:
            self._page.write(servo_id, servo.target_deg if servo.energised else None)


TICK_NS: Final = 1_000_000
RECEIVE_TIMEOUT_TICKS: Final = 1000  # HEXAPOD_RECEIVE_TIMEOUT

_RECEIVE_BUFFER_LEN: Final = 64  # MESSAGE_MAX_LEN
_HARMLESS_LEN: Final = 68  # the next byte is the SPI handle's
_RECORDS_BY_LEN_AND_TYPE: Final = {  # where each servo's four bytes begin
    (ONE_LEG_LEN, ONE_LEG_TYPE): (2, 6, 10),
    (ONE_SERVO_LEN, ONE_SERVO_TYPE): (2,),
}
_TABLE: Final = dict(enumerate(SERVO_IDS))
_FAULTY_ENTRIES: Final = range(252, 256)
"""The entries just before the table, by an index of 8 bits: bus faults."""
_ENTRIES_PAST_THE_TABLE: Final = {18: 11, 23: 21}
"""The servos that these drive in the -Og build."""
_DONE: Final = {Op.START: "started at", Op.SET: "set to"}


class SimulatedController(SpiDevice):
    """A device with a simulated controller and its servos. Closing it stops no servo."""

    def __init__(
        self,
        framing: Framing,
        *,
        clock: Callable[[], int] = time.monotonic_ns,
        on_change: Callable[[str], None] | None = None,
        tick_phase_ns: int = 0,
        page: ServoPage | None = None,
    ) -> None:
        """`clock` returns ns. `on_change` gets a line on each executed frame and on a crash, `page` the targets."""
        self.executed = 0
        self.corruptions: collections.Counter[str] = collections.Counter()
        self.dead: str | None = None
        """Why the firmware died, or None. A dead one receives nothing."""
        self._announced = framing is Framing.LENGTH_PREFIXED
        self._clock = clock
        self._say = on_change or (lambda _: None)
        self._tick_phase_ns = tick_phase_ns

        self._body = bytearray()
        self._body_len = 0  # 0: the next byte is a length
        self._give_up_ns = 0

        self._servos = SimulatedServos(clock(), page)

    # ---- the device

    def transfer(self, batch: Batch) -> None:
        for data, _ in batch:  # without pauses
            self.take(data)

    # ---- the firmware

    def take(self, data: bytes) -> None:
        """Take the bytes of one transfer."""
        now_ns = self._clock()
        self._expire_receive(now_ns)
        for byte in data:
            if self.dead is not None:
                return
            if self._body_len == 0:
                self._expect(byte, now_ns)
            else:
                self._body.append(byte)
            if self._announced and len(self._body) > _HARMLESS_LEN:
                self._die(f"{len(self._body)} bytes in a buffer of {_RECEIVE_BUFFER_LEN} overwrote its SPI handle")
            elif 0 < self._body_len == len(self._body):
                self._interpret(now_ns)

    def _expect(self, length: int, now_ns: int) -> None:
        if length > _RECEIVE_BUFFER_LEN:
            self.corruptions[f"a length of {length} overran the receive buffer of {_RECEIVE_BUFFER_LEN} bytes"] += 1
        self._body_len = length
        if length > 0 and not self._announced:
            self._body.append(length)
        tick = (now_ns + self._tick_phase_ns) // TICK_NS
        self._give_up_ns = (tick + RECEIVE_TIMEOUT_TICKS) * TICK_NS - self._tick_phase_ns

    def _expire_receive(self, now_ns: int) -> None:
        if self._body_len and now_ns >= self._give_up_ns and self.dead is None:
            self._body = self._body.ljust(self._body_len, b"\0") if self._announced else bytearray()
            self._interpret(self._give_up_ns)

    def _interpret(self, now_ns: int) -> None:
        """Execute the bytes received."""
        body, self._body, self._body_len = self._body, bytearray(), 0
        records = _RECORDS_BY_LEN_AND_TYPE.get((len(body), body[1])) if len(body) > 1 else None
        if records is None:
            return
        self._servos.move(now_ns)
        changes = []
        for start in records:
            changes.append(self._drive(*body[start : start + 4]))
            if self.dead is not None:
                return
        self.executed += 1
        self._say("; ".join(changes))

    def _drive(self, servo_id: int, op: int, whole_deg: int, hundredths: int) -> str:
        if op not in (Op.START, Op.STOP, Op.SET):
            return f"operation {op} ignored"
        index = ((servo_id // 10 - 1) * 3 + servo_id % 10 - 1) & 0xFF  # the firmware's arithmetic, in a uint8_t
        driven_id = _TABLE.get(index)
        if self._announced and driven_id is None:
            driven_id = _ENTRIES_PAST_THE_TABLE.get(index)
        if driven_id is None:
            what = f"servo id {servo_id} indexed entry {index} of a servo table of {len(SERVO_IDS)}"
            self.corruptions[what] += 1
            if self._announced and index in _FAULTY_ENTRIES:
                self._die(f"servo id {servo_id} with operation {op} is a bus fault")
            return what
        if driven_id != servo_id:
            self.corruptions[f"servo id {servo_id} drove servo {driven_id}"] += 1
        if op == Op.STOP:
            self._servos.stop(driven_id)
            return f"servo {driven_id} stopped"
        servo = self._servos[driven_id]
        servo.pulse_us = pulse_us(whole_deg, hundredths)
        self._servos.send(driven_id, (servo.pulse_us - 544) * 180 / (2550 - 544), start=op == Op.START)
        change = f"servo {driven_id} {_DONE[Op(op)]} {whole_deg + hundredths / 100:.2f}°, {servo.pulse_us} µs"
        return change if servo.energised else f"{change}, and stays off"

    def _die(self, why: str) -> None:
        self.dead = why
        self._say(f"the controller is dead until it is reset: {why}")


def _float32(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


@functools.cache
def pulse_us(whole_deg: int, hundredths: int) -> int:
    """Return the compare value, in µs, that the firmware sets for INT PART and FLOAT PART: 544 at 0°, 2550 at 180°.

    Rounded to single precision after each operation, in the firmware's order, then truncated.
    """
    angle_deg = _float32(whole_deg + _float32(hundredths / _float32(100.0)))
    scaled = _float32(_float32(angle_deg * (2550.0 - 544.0)) / 180.0)
    return int(_float32(scaled + 544.0))
