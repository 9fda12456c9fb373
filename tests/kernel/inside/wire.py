"""The module's log and parameters: what the controller was asked to do, message by message."""

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

DEVICE: Final = "/dev/spidev0.0"
LOG: Final = Path("/sys/kernel/debug/spirec/log")
PARAMETERS: Final = Path("/sys/module/spirec/parameters")
ASSERTED, RELEASED, BEGIN, END, PREPARE, UNPREPARE, LOST = range(1, 8)
_RECORD: Final = struct.Struct("=QIIIHBBhH20s")
_FAULTS: Final = ("fail_in", "lose_in", "lose_zeros", "hang_in", "xfer_sleep_us")


class Record(NamedTuple):
    """`struct rec` of the module."""

    ns: int
    process: int
    speed_hz: int
    mode: int
    size: int
    kind: int
    bits: int
    result: int
    delay_us: int
    data: bytes


@dataclass
class Transfer:
    """One transfer, and chip select around it; times of the machine's monotonic clock, 0 where it did not come."""

    data: bytes
    speed_hz: int
    bits: int
    mode: int
    delay_us: int
    begin_ns: int
    asserted_ns: int = 0
    end_ns: int = 0
    released_ns: int = 0
    result: int | None = None
    """0: it passed. None: lost."""

    @property
    def setting(self) -> tuple[int, int, int]:
        return self.speed_hz, self.bits, self.mode


@dataclass
class Message:
    """The transfers that Linux carried out as one."""

    transfers: list[Transfer] = field(default_factory=list)
    status: int = 0
    edges: list[tuple[bool, int]] = field(default_factory=list)
    """Chip select asserted or released, and when."""
    unprepared_ns: int = 0

    @property
    def data(self) -> list[bytes]:
        return [each.data for each in self.transfers]


def forget() -> None:
    """Empty the log."""
    LOG.write_text("0")


def give(**parameters: int) -> None:
    for name, value in parameters.items():
        (PARAMETERS / name).write_text(str(value))


def heal() -> None:
    give(**dict.fromkeys(_FAULTS, 0))


def records() -> list[Record]:
    """All since `forget`."""
    return [Record(*each) for each in _RECORD.iter_unpack(LOG.read_bytes())]


def messages() -> list[Message]:
    """All since `forget`, in order; the last one may be unfinished."""
    found: list[Message] = []
    for each in records():
        if each.kind == PREPARE:
            found.append(Message())
        elif found and not found[-1].unprepared_ns:
            _note(found[-1], each)
    return found


def _note(message: Message, record: Record) -> None:
    last = message.transfers[-1] if message.transfers else None
    if record.kind == BEGIN:
        asserted_ns = message.edges[-1][1] if message.edges and message.edges[-1][0] else 0
        data, setting = record.data[: record.size], (record.speed_hz, record.bits, record.mode)
        message.transfers.append(Transfer(data, *setting, record.delay_us, record.ns, asserted_ns))
    elif record.kind == END and last is not None:
        last.end_ns, last.result = record.ns, record.result
    elif record.kind in (ASSERTED, RELEASED):
        message.edges.append((record.kind == ASSERTED, record.ns))
        if record.kind == RELEASED and last is not None and not last.released_ns:
            last.released_ns = record.ns
    elif record.kind == UNPREPARE:
        message.status, message.unprepared_ns = record.result, record.ns


def passed() -> list[Transfer]:
    """All transfers that reached a controller, in order."""
    return [each for message in messages() for each in message.transfers if each.result == 0]


def lost() -> list[Record]:
    """All that Linux gave up on."""
    return [each for each in records() if each.kind == LOST]


# ---- the bytes of the protocol, written down here once more, so that the gateway's code is not its own witness

SIX: Final = range(1, 7)


def leg(number: int, op: int, whole: int = 0) -> bytes:
    """ONE LEG: all three servos of it."""
    servos = (bytes((number * 10 + joint, op, whole, 0)) for joint in (1, 2, 3))
    return bytes((14, 1)) + b"".join(servos)


STOPS: Final = [leg(each, 2) for each in SIX]


def announced(frames: list[bytes]) -> list[bytes]:
    """Frames as the published firmware wants them: each length first."""
    return [part for frame in frames for part in (frame[:1], frame)]
