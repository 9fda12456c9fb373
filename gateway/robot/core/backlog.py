"""Distinguishes a live stream from a backlog, and delays starts that may belong to one. Pure: time is an argument.

A link that stalls delivers a program's messages later, perhaps after the program has died. A command with `sent_ms`
shows its delay (`model/staleness.py`). Without it, only the rhythm of the messages does: a program's messages arrive
one by one, a backlog's arrive in clumps, since a TCP segment contains several.

- Each key has a *score*. A message that arrives alone takes one away; each further message of the same moment adds
  three. Messages without `sent_ms` count, also if they are rejected. After `Rules.quiet_ns` without one, the key
  begins anew.
- A start without `sent_ms` of a servo that does not run waits for `Rules.start_wait_ns`, and further while a key that
  addresses the servo has a score. Newer messages replace the waiting start.
- If the keys with a score fall silent, the start leaves if it belongs to three messages at most, and is rejected
  otherwise. It is also rejected after `Rules.proof_ns`.

Running servos take every command, and a Stop is always carried out.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from gateway.rate_limit import NS_PER_MS, NS_PER_S
from gateway.robot.core.events import Command, Effect
from gateway.robot.core.legs import Legs
from gateway.robot.core.message import Verb
from gateway.robot.core.rules import Rules
from gateway.robot.core.servo import WAITING, Servo
from schemas.words import Reason

START_WAIT_NS: Final = 15 * NS_PER_MS
"""The frame of a lone start leaves within a rate slot of 50 Hz, with 5 ms for a timer that is late."""
CLUMPED: Final = 3
"""What a message of a clump adds: a stream may have one clumped message in four, and a backlog has at least two in
five, since its segments contain more than one and a half messages."""
FEW: Final = 3
"""Up to this many messages of a key start a servo, even in a clump."""
_GET: Final = Verb.GET


@dataclass(slots=True)
class Stretch:
    """A key's messages without `sent_ms`, with no silence between them."""

    begun_ns: int
    last_ns: int = 0
    count: int = 0
    instant_ns: int = -NS_PER_S
    """The instant of the latest message."""
    score: int = 0
    servos: frozenset[int] = frozenset()
    """The servos that they start or set."""


class Backlog:
    """The rhythm of each key's messages without `sent_ms`, and the starts that wait for its judgement."""

    def __init__(self, rules: Rules, legs: Legs) -> None:
        self._rules = rules
        self._legs = legs
        self._judged_ns = legs.gates.burst.judged_ns
        self._stretches: dict[str, Stretch] = {}
        self.held: dict[int, int] = {}
        """Servos whose starts wait, and since when (ns)."""

    def note(self, command: Command, now_ns: int) -> None:
        """Count a command without `sent_ms`: does it arrive alone, or in a clump?"""
        rules = self._rules
        if not rules.start_wait_ns or not command.moves:
            return
        instant_ns = self._legs.instant_ns
        stretch = self._stretches.get(command.key)
        if stretch is None or now_ns - stretch.last_ns >= rules.quiet_ns:
            stretch = self._stretches[command.key] = Stretch(now_ns)
        stretch.last_ns = now_ns
        stretch.count += 1
        stretch.servos = stretch.servos.union([servo_id for servo_id, _ in command.moves])
        apart_ns = instant_ns - stretch.instant_ns
        stretch.instant_ns = instant_ns
        # A program that waits for each answer may be faster than a stream.
        least_ns = 1 if command.verb is _GET else rules.apart_ns
        if apart_ns < least_ns:
            stretch.score = min(rules.most_clumped, stretch.score + CLUMPED)
        elif stretch.score:
            stretch.score -= 1
            for servo_id in self.held.keys() & stretch.servos if not stretch.score else ():
                self._judged_ns[servo_id] = now_ns + 1  # judged in the next step

    # mutants accepted (Forget): without a waiting start both do nothing
    def hold(self, command: Command, now_ns: int) -> None:
        """Delay the starts of an accepted command without `sent_ms`. With `sent_ms`, end their delay."""
        if not self._rules.start_wait_ns:
            return
        legs = self._legs
        servos: Iterable[Servo] = [legs.servos[servo_id] for servo_id, _ in command.moves]
        if self._rules.starts_whole and command.moves:  # all servos start in one step
            servos = legs.servos.values()
        released_ns = now_ns - self._rules.silence_ns  # one that waits for its power, for instance
        for servo in servos:
            since_ns = self.held.pop(servo.servo_id, released_ns) if servo.life is WAITING else now_ns
            self._judged_ns.pop(servo.servo_id, None)
            again_ns = None
            if command.sent_ms is None and not servo.running:
                again_ns, _ = self._judge(servo, since_ns, now_ns)
            if again_ns is not None:
                self.held[servo.servo_id] = since_ns
                self._judged_ns[servo.servo_id] = max(again_ns, now_ns + 1)  # not rejected in this step

    def expire(self, now_ns: int) -> list[Effect]:
        """Release the starts that have waited long enough, and reject those that belong to a backlog."""
        late: dict[Servo, str] = {}
        for servo_id, judged_ns in [*self._judged_ns.items()]:
            servo, again_ns, key = self._legs.servos[servo_id], None, ""
            if servo.life is WAITING:
                again_ns = judged_ns
                if now_ns >= judged_ns:
                    again_ns, key = self._judge(servo, self.held[servo_id], now_ns)
            if again_ns is not None and again_ns > now_ns:
                self._judged_ns[servo_id] = again_ns
                continue
            del self._judged_ns[servo_id], self.held[servo_id]
            if again_ns is not None:
                late[servo] = key
        effects: list[Effect] = []
        for key in dict.fromkeys(late.values()):
            effects += self._legs.drop([each for each in late if late[each] == key], Reason.STALE, self._why(key))
        return effects

    def _judge(self, servo: Servo, since_ns: int, now_ns: int) -> tuple[int | None, str]:
        """Return when to judge a waiting start again (None: it leaves; not later than now: it is rejected).

        With it comes the key that is to blame.
        """
        rules = self._rules
        found = [
            (each, key)
            for key, each in self._stretches.items()
            if now_ns - each.last_ns < rules.quiet_ns and (rules.starts_whole or servo.servo_id in each.servos)
        ]
        more = any(each.last_ns > since_ns for each, _ in found)
        wait_ns = since_ns + (rules.silence_ns if more else rules.start_wait_ns)
        wait_ns = max([wait_ns, *(each.begun_ns + rules.start_wait_ns for each, _ in found)])
        clumped = [(each.count, each.last_ns, key) for each, key in found if each.score]
        if now_ns < wait_ns or not clumped:
            return (wait_ns, "") if now_ns < wait_ns else (None, "")
        most, _, key = max(clumped)
        silent_ns = max(last_ns for _, last_ns, _ in clumped) + rules.silence_ns
        if now_ns >= silent_ns and most <= FEW:
            return None, key
        return min(silent_ns, since_ns + rules.proof_ns), key

    def _why(self, key: str) -> str:
        return (
            f"the messages on {key} arrive in clumps, as after a delay; send sent_ms, or "
            f"wait {self._rules.quiet_ns // NS_PER_MS} ms"
        )
