"""A simulated CAN adapter that speaks slcan on a serial line, and the faults of the way through it. Pure.

| line          | answer        | does                                                    |
|---------------|---------------|---------------------------------------------------------|
| S0-S8, sXXXX  | `\\r`          | sets the bit rate, while the channel is closed           |
| O, L          | `\\r`          | opens the channel; L: to listen alone                    |
| C             | `\\r`          | closes it                                                |
| V, N, F       | words, `\\r`   | version, serial number, status                           |
| tIIILDD…      | `\\r`          | puts a frame on the bus                                  |
| r, T, R       | `\\r`          | frames of other kinds, which the power board does not take |
| nothing       | `\\r`          |                                                         |
| anything else | `\\a`          | as what is not allowed now                               |

While the channel is open, each frame on the bus leaves as `tIIILDD…\\r`.
"""

import random
from collections import deque
from typing import Final

from gateway.model.power_board import CanFrame

OK: Final = b"\r"
ERROR: Final = b"\a"
_LONGEST: Final = 32
"""Bytes of a line; T with 8 bytes of data has 26."""
_WORDS: Final = {b"V": b"V1013", b"N": b"NSIM1", b"F": b"F00"}


class SimulatedAdapter:
    """The adapter; its channel is closed at first."""

    def __init__(self) -> None:
        self._open = self._listens = False
        self._line = bytearray()

    def take(self, data: bytes) -> tuple[list[CanFrame], bytes]:
        """Bytes of its client arrive: the frames for the bus, and what it answers."""
        frames: list[CanFrame] = []
        answers = bytearray()
        for byte in data:
            if byte == OK[0]:
                answers += self._obey(bytes(self._line), frames)
                self._line.clear()
            elif len(self._line) < _LONGEST:
                self._line.append(byte)
        return frames, bytes(answers)

    def text(self, frame: CanFrame) -> bytes:
        """What its client gets of a frame on the bus; nothing while the channel is closed."""
        return text_of(frame) if self._open else b""

    def _obey(self, line: bytes, frames: list[CanFrame]) -> bytes:
        command = line[:1]
        if command in _WORDS:
            return _WORDS[command] + OK
        if command in (b"O", b"L") and not self._open:
            self._open, self._listens = True, command == b"L"
            return OK
        if command == b"C":
            self._open = False
            return OK
        if command in (b"S", b"s") and not self._open:
            return OK
        if command in (b"t", b"T", b"r", b"R") and self._open and not self._listens:
            frame = frame_of(line) if command == b"t" else None
            if frame is not None:
                frames.append(frame)
            return OK if frame is not None or command != b"t" else ERROR
        return ERROR if line else OK


def text_of(frame: CanFrame) -> bytes:
    """`tIIILDD…` and a carriage return."""
    return b"t%03X%d%s\r" % (frame.id, len(frame.data), frame.data.hex().upper().encode())


def frame_of(line: bytes) -> CanFrame | None:
    """The frame of `tIIILDD…`; None where the line is none."""
    try:
        identifier, length, data = int(line[1:4], 16), int(line[4:5]), bytes.fromhex(line[5:].decode("ascii"))
    except ValueError:
        return None
    if not (line[:1] == b"t" and 0 <= identifier <= 0x7FF and len(data) == length <= 8 and len(line) == 5 + 2 * length):
        return None
    return CanFrame(identifier, data)


class SimulatedLink:
    """One direction between the board and the adapter, at first without faults. Frames keep their order, so a late one
    holds back those behind it."""

    def __init__(self, seed: int = 0) -> None:
        self.lose = self.corrupt = self.delay = 0.0
        """The chance of each frame, 0 to 1: it is lost, one of its bits or its length is wrong, or it is late."""
        self.delay_ns = 50_000_000
        self.chance = random.Random(seed)  # noqa: S311  (faults, no secrets)
        self._waits_until_ns = 0
        self._under_way: deque[tuple[int, CanFrame]] = deque()

    def pause(self, until_ns: int) -> None:
        """Until then nothing arrives; then all that was sent meanwhile arrives at once."""
        self._waits_until_ns = until_ns

    def send(self, frame: CanFrame, now_ns: int) -> None:
        """A frame leaves."""
        chance = self.chance.random
        if chance() < self.lose:
            return
        if chance() < self.corrupt:
            frame = self._corrupted(frame)
        self._under_way.append((now_ns + self.delay_ns if chance() < self.delay else now_ns, frame))

    def arrived(self, now_ns: int) -> list[CanFrame]:
        """What arrives up to now, in order."""
        frames = []
        while self._under_way and self.due_ns <= now_ns:
            frames.append(self._under_way.popleft()[1])
        return frames

    @property
    def due_ns(self) -> int:
        """When the next frame arrives; only while one is under way."""
        return max(self._under_way[0][0], self._waits_until_ns)

    def __len__(self) -> int:
        return len(self._under_way)

    def _corrupted(self, frame: CanFrame) -> CanFrame:
        data = bytearray(frame.data)
        if not data or self.chance.random() < 0.5:
            return CanFrame(frame.id, bytes(data[:-1] if len(data) == 8 else data + b"\0"))
        data[self.chance.randrange(len(data))] ^= 1 << self.chance.randrange(8)
        return CanFrame(frame.id, bytes(data))
