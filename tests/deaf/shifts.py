"""One byte lost or doubled: in which legal frames the firmware then reads an id that kills, or a length over 68.

There are some 10^14 legal frames, and the rule looks at two bytes of one record: its id and its operation. Each of
them is one byte of the frame, the byte that follows it, or a zero of the firmware's timeout. So a fault is tried once,
on the places of the bytes, and then all values are gone through that the two places can have together in legal frames.
"""

from collections.abc import Iterator
from functools import cache
from itertools import product
from typing import Final, NamedTuple

from gateway.model.frames import ONE_LEG_LEN, ONE_SERVO_LEN, OneServo, Op, ServoOp, servo_ids_of
from schemas.robot import LEGS, SERVO_IDS

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
        """Return whose it is, counted from 0; None: nobody's."""
        record = self.at - 3
        return record // 4 if 0 <= record < 4 * self.servos else None

    @property
    def field(self) -> int:
        """Of a servo's byte: 0 id, 1 operation, 2 whole degrees, 3 hundredths."""
        return (self.at - 3) % 4


@cache
def commands(avoid_cdeg: Avoid) -> frozenset[tuple[int, int, int]]:
    """Operation, whole degrees and hundredths of everything that may be said of a servo, as the encoder writes it."""
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
