"""Bytes lost or doubled in legal frames, bits flipped in a run of Stops: what the simulated firmware then does."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from itertools import combinations, product
from typing import Final, NamedTuple

from gateway.model.frames import ONE_LEG_LEN, ONE_SERVO_LEN, Framing, OneServo, Op, ServoOp, servo_ids_of
from schemas.robot import LEGS, SERVO_IDS
from tests.deaf.faults import GIVEN_UP_NS, Written
from tests.support.controllers import Controller

RECORDS: Final = {(14, 1): (2, 6, 10), (6, 2): (2,)}
KILLS: Final = frozenset(product((0, 1, 2, 3, 10), (1, 2, 3)))
"""Ids, each with the operation behind it: the table index 252 to 255."""
FOLLOWERS: Final = (0, ONE_SERVO_LEN, ONE_LEG_LEN)
"""The byte behind a frame: a zero, of the preamble or of the timeout, or an announcement."""

Avoid = tuple[int, int] | None


class Place(NamedTuple):
    """A byte of an announced frame (0 is the announcement) with so many servos, or the byte behind it."""

    servos: int
    at: int

    @property
    def servo(self) -> int | None:
        """Return the servo that the byte belongs to, counted from 0, or None."""
        record = self.at - 3
        return record // 4 if 0 <= record < 4 * self.servos else None

    @property
    def field(self) -> int:
        """Return the byte's field of a servo: 0 id, 1 operation, 2 whole degrees, 3 hundredths."""
        return (self.at - 3) % 4


@cache
def commands(avoid_cdeg: Avoid) -> frozenset[tuple[int, int, int]]:
    """Return operation, whole degrees and hundredths of every command for a servo, as the encoder writes them."""
    low, high = avoid_cdeg or (0, 0)
    moves = (ServoOp(op, cdeg) for op in (Op.START, Op.SET) for cdeg in range(180_01) if not low <= cdeg < high)
    found = set()
    for command in (ServoOp(Op.STOP), *moves):
        op, whole_deg, hundredths = OneServo(11, command).data[3:]
        found.add((op, whole_deg, hundredths))
    return frozenset(found)


@cache
def values(place: Place, avoid_cdeg: Avoid) -> frozenset[int]:
    """Return all that this byte can be."""
    length = 2 + 4 * place.servos
    if place.at < 2:
        return frozenset({length})
    if place.at == 2:
        return frozenset({1 if length == ONE_LEG_LEN else 2})
    if place.servo is None:
        return frozenset(FOLLOWERS)
    if place.field == 0:
        third = [servo_ids_of(leg)[place.servo] for leg in LEGS]
        return frozenset(SERVO_IDS if place.servos == 1 else third)
    return frozenset(command[place.field - 1] for command in commands(avoid_cdeg))


@cache
def together(first: Place, second: Place, avoid_cdeg: Avoid) -> frozenset[tuple[int, int]]:
    """Return all that two bytes can be at once: those of one servo depend on each other, any others do not."""
    if first.servo is not None and first.servo == second.servo and first.field and second.field:
        pairs = ((command[first.field - 1], command[second.field - 1]) for command in commands(avoid_cdeg))
        return frozenset(pairs)
    return frozenset(product(values(first, avoid_cdeg), values(second, avoid_cdeg)))


def announced(servos: int) -> list[Place]:
    """Return the places of an announced frame, and of the byte behind it."""
    return [Place(servos, at) for at in range(1 + 2 + 4 * servos + 1)]


def faults(servos: int) -> Iterator[tuple[str, list[Place]]]:
    """Yield an announced frame with each byte lost, and with each byte doubled."""
    *frame, behind = announced(servos)
    for at in range(len(frame)):
        yield f"byte {at} lost", [*frame[:at], *frame[at + 1 :], behind]
        yield f"byte {at} doubled", [*frame[: at + 1], *frame[at:], behind]


def worst(stream: list[Place], avoid_cdeg: Avoid) -> frozenset[tuple[int, int]]:
    """Id and operation of records that kill, in the worst of all legal frames.

    The firmware reads a length, that many bytes, a look at them, the next length.
    """
    (length,) = values(stream[0], avoid_cdeg)
    body = stream[1 : 1 + length]
    killing: set[tuple[int, int]] = set()
    for frame_type in values(body[1], avoid_cdeg):
        for at in RECORDS.get((length, frame_type), ()):
            pairs = together(body[at], body[at + 1], avoid_cdeg)
            killing |= pairs & KILLS
    return frozenset(killing)


RUN_NS = 10_000_000
"""Transfers that are closer are of one run."""


def runs(log: Sequence[Written]) -> list[tuple[int, bytes]]:
    """Return each run's time and bytes, with the preamble before it."""
    found: list[tuple[int, bytes]] = []
    for before, written in zip((None, *log), log, strict=False):
        if before is not None and written.at_ns - before.at_ns < RUN_NS:
            found[-1] = found[-1][0], found[-1][1] + written.data
        else:
            found.append((written.at_ns, written.data))
    return found


def flipped(data: bytes, bits: Iterable[int]) -> bytes:
    """Return the bytes with these bits inverted, counted from bit 0 of byte 0."""
    changed = bytearray(data)
    for bit in bits:
        changed[bit >> 3] ^= 1 << (bit & 7)
    return bytes(changed)


def one_bit(data: bytes) -> list[bytes]:
    return [flipped(data, [bit]) for bit in range(8 * len(data))]


def two_bits_of_a_byte(data: bytes) -> list[bytes]:
    pairs = combinations(range(8), 2)
    return [flipped(data, [8 * at + bit for bit in pair]) for pair in pairs for at in range(len(data))]


def one_more(data: bytes) -> list[bytes]:
    """Return one byte of any value inserted before each."""
    return [data[:at] + bytes([value]) + data[at:] for at in range(len(data)) for value in range(256)]


def outcomes(faulty: Iterable[bytes], then: Sequence[tuple[int, bytes]] = (), *, running: bool = False) -> Counter[str]:
    """Return how many faulty runs, each with the runs `then` (ns after it), end "on", "dead", "dead and on" or "off".

    `running`: whether all servos are on before; else all are off.
    """
    found = Counter[str]()
    for data in faulty:
        now = [0]
        controller = Controller(Framing.LENGTH_PREFIXED, clock=lambda now=now: now[0])
        for servo_id in controller.servos if running else ():
            controller.servos.send(servo_id, 90.0, start=True)
        for now[0], each in ((0, data), *then):
            controller.take(each)
        now[0] += GIVEN_UP_NS
        words = [word for word, true in (("dead", controller.dead), ("on", controller.energised)) if true]
        found[" and ".join(words) or "off"] += 1
    return found
