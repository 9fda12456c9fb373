"""Messages without `sent_ms` as programs send them, as a link delivers them, and as the gateway reads them.

All in virtual time: a list of arrivals goes through a model of the reader into a supervisor. An arrival is (when in
ms, key, command's operation, verb).
"""

import json
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Final, NamedTuple

from gateway.model.frames import STOP, Op, ServoOp, servo_ids_of
from gateway.rate_limit import NS_PER_MS
from gateway.robot.core.events import BusOpened, Command, Rejected, TimePassed, Transmit
from gateway.robot.core.message import Verb
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.zenoh_io.rings import RING_DEPTH, put_depth
from schemas.keys import COMMAND_KEYS, Target
from schemas.robot import LEGS

SEGMENT: Final = 1448
"""Bytes of a program that a TCP segment carries on Ethernet and Wi-Fi."""
OVERHEAD: Final = 40
"""Bytes around a payload: Zenoh's lengths and headers, the key, the encoding."""


class Arrival(NamedTuple):
    """A message at the gateway."""

    at_ms: float
    key: str
    op: Op
    verb: Verb = Verb.PUT

    @property
    def size(self) -> int:
        """Bytes on the link."""
        one = {"op": self.op.name.lower(), "angle_deg": 91.37}
        leg = {"servos": [one] * 3}
        target = COMMAND_KEYS[self.key].target
        payloads = {Target.SERVO: one, Target.LEG: leg, Target.LEGS: {"legs": {str(each): leg for each in LEGS}}}
        return len(json.dumps(payloads[target])) + OVERHEAD


def delivered(sent: Iterable[Arrival], mbit_s: float) -> Iterator[Arrival]:
    """Deliver what a link has held back from 0 ms on, in full segments; 0 Mbit/s: all at once."""
    end = 0
    for each in sent:
        end += each.size
        segments = -(-end // SEGMENT)  # a message is complete with its last segment
        yield each._replace(at_ms=segments * SEGMENT * 8 / mbit_s / 1000 if mbit_s else 0.0)


def targets_of(key: str, op: ServoOp) -> tuple[tuple[int, ServoOp], ...]:
    """Return what a message on this key names."""
    target, number = COMMAND_KEYS[key]
    legs = {Target.LEGS: tuple(LEGS), Target.LEG: (number,)}.get(target, ())
    return tuple((servo, op) for leg in legs for servo in servo_ids_of(leg)) or ((number, op),)


class Robot:
    """A supervisor behind a model of the reader: a ring for each key, of which it reads the newest messages."""

    def __init__(
        self,
        rules: Rules,
        *,
        each_ms: float = 0.1,
        wake_ms: float = 0.1,
        pauses: Sequence[tuple[float, float]] = (),
        timed: bool = False,
    ) -> None:
        """`each_ms`: how long a message takes; `wake_ms`: how long the reader takes to wake up; `timed`: has `sent_ms`.

        During `pauses` (from, to; in ms) the machine is busy, and the reader does not run.
        """
        self.supervisor = Supervisor(rules)
        self.each_ms, self.wake_ms, self.pauses, self.timed = each_ms, wake_ms, pauses, timed
        self.frames: list[tuple[float, int]] = []
        """When a frame moved which leg."""
        self.rejected: list[tuple[float, Rejected]] = []
        self.started: set[int] = set()
        """The servos that a frame has started."""
        self.commanded: set[int] = set()
        """The legs that messages named."""
        self.read: list[int] = []
        """How many messages of a key each instant had."""
        self._depth = put_depth(50, 250)
        self._step(0, BusOpened())

    def _step(self, at_ms: float, event: object, instant_ms: float | None = None) -> None:
        instant_ns = None if instant_ms is None else _ns(instant_ms)
        for effect in self.supervisor.step(event, _ns(at_ms), instant_ns):  # type: ignore[arg-type]
            if isinstance(effect, Transmit) and not effect.frame.is_stop:
                self.frames.append((at_ms, effect.frame.leg))
                self.started |= {servo for servo, op in effect.frame.servos if op.op is Op.START}
            elif isinstance(effect, Rejected):
                self.rejected.append((at_ms, effect))

    @staticmethod
    def servos_of(key: str) -> set[int]:
        """Return what a message on this key names."""
        return {servo for servo, _ in targets_of(key, STOP)}

    def run(self, arrivals: Iterable[Arrival], until_ms: float) -> "Robot":
        """Let them arrive, and time pass until then."""
        waiting = deque(sorted(arrivals, key=lambda each: each.at_ms))
        now_ms = 0.0
        while True:
            due_ns = self.supervisor.due_ns
            due_ms = until_ms + 1 if due_ns is None else due_ns / NS_PER_MS - START_MS
            came_ms = waiting[0].at_ms + self.wake_ms if waiting else until_ms + 1
            now_ms = self._awake(max(now_ms, min(due_ms, came_ms)))
            if now_ms > until_ms:
                return self
            rings: dict[str, deque[Arrival]] = {}
            while waiting and waiting[0].at_ms <= now_ms:
                each = waiting.popleft()
                rings.setdefault(each.key, deque(maxlen=self._depth)).append(each)
            instant_ms = now_ms
            for key in COMMAND_KEYS:
                newest = [*rings.get(key, ())][-RING_DEPTH:]
                self.read += [len(newest)] if newest else []
                for each in newest:
                    angle = 90_00 + round(each.at_ms) % 1000
                    sent_ms = each.at_ms if self.timed else None
                    command = Command(targets_of(key, ServoOp(each.op, angle)), key=key, sent_ms=sent_ms)
                    command.verb = each.verb
                    self.commanded |= set(command.by_leg)
                    self._step(now_ms, command, instant_ms)
                    now_ms += self.each_ms
            if not rings or now_ms >= due_ms:
                self._step(now_ms, TimePassed(), instant_ms)

    def _awake(self, at_ms: float) -> float:
        return next((to for begun, to in self.pauses if begun <= at_ms < to), at_ms)


START_MS: Final = 60_000


def _ns(at_ms: float) -> int:
    return round((START_MS + at_ms) * NS_PER_MS)
