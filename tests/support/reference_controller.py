"""The published firmware's receiver once more, written another way: byte for byte, with all that was heard kept.

`SimulatedController` is compared with it. The two share only the pulse widths, which have vectors of their own.
"""

from gateway.simulation.controller import pulse_us
from schemas.robot import SERVO_IDS

TICK_NS = 1_000_000
UP_TO_THE_HANDLE = 68


class ReferenceController:
    """Which servos are energised, and at which pulse, after these transfers."""

    def __init__(self, *, announced: bool) -> None:
        self.announced = announced
        self.energised: set[int] = set()
        self.pulses: dict[int, int] = {}
        self.executed = 0
        self.dead = False
        self._heard: list[int] | None = None  # None: waiting for a length
        self._wanted = 0
        self._since_tick = 0

    def transfer(self, data: bytes, now_ns: int) -> None:
        if self._heard is not None and now_ns // TICK_NS - self._since_tick >= 1000:
            if self.announced:
                self._execute(self._heard + [0] * (self._wanted - len(self._heard)))
            self._heard = None
        for byte in data:
            if self.dead:
                return
            if self._heard is not None:
                self._heard.append(byte)
            elif byte:
                self._heard = [] if self.announced else [byte]
                self._wanted, self._since_tick = byte, now_ns // TICK_NS
            if self.announced and self._heard is not None and len(self._heard) > UP_TO_THE_HANDLE:
                self.dead, self._heard = True, None
            if self._heard is not None and len(self._heard) == self._wanted:
                self._execute(self._heard)
                self._heard = None

    def _execute(self, body: list[int]) -> None:
        if (len(body), body[1:2]) not in ((6, [2]), (14, [1])):
            return
        for servo_id, op, whole, hundredths in (body[start : start + 4] for start in range(2, len(body), 4)):
            if self.announced and servo_id in (0, 1, 2, 3, 10) and op in (1, 2, 3):
                self.dead = True  # a bus fault
                return
            index = ((servo_id // 10 - 1) * 3 + servo_id % 10 - 1) % 256
            past = {18: 11, 23: 21} if self.announced else {}
            if index >= len(SERVO_IDS) and index not in past:
                continue
            driven = SERVO_IDS[index] if index < len(SERVO_IDS) else past[index]
            if op == 2:
                self.energised.discard(driven)
            if op == 1:
                self.energised.add(driven)
            if op in (1, 3):
                self.pulses[driven] = pulse_us(whole, hundredths)
        self.executed += 1
