"""Bits flipped and bytes inserted in a run of Stops, on the simulated firmware: what is on, or dead, afterwards."""

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import combinations

from gateway.model.frames import Framing
from tests.deaf.faults import GIVEN_UP_NS, Written
from tests.support.controllers import Controller

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
