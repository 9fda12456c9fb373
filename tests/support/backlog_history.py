"""What a judge of the supervisor remembers of messages without a time: how each key's messages have arrived."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple, Self

from gateway.robot.core.events import Command
from gateway.robot.core.message import Verb
from gateway.robot.core.rules import Rules

LONG_AGO_NS = -(10**9)


class Rhythm(NamedTuple):
    """One key's messages since it was last quiet."""

    first_ns: int
    last_ns: int
    instant_ns: int
    messages: int
    score: int
    servos: frozenset[int]
    """All that they start or set."""

    def key(self, now_ns: int, rules: Rules) -> tuple[object, ...]:
        """Return what of it still matters."""
        young_ns = max(0, self.first_ns + rules.start_wait_ns - now_ns)
        apart_ns = max(0, self.instant_ns + rules.apart_ns - now_ns)
        return young_ns, now_ns - self.last_ns, apart_ns, min(self.messages, 4), self.score, self.servos


@dataclass(slots=True)
class BacklogHistory:
    """How messages without a time came on each key, and since when servos' starts wait for what comes after them."""

    rules: Rules
    rhythms: dict[str, Rhythm] = field(default_factory=dict)
    waiting_ns: dict[int, int] = field(default_factory=dict)
    taken_ns: dict[int, int] = field(default_factory=dict)
    """When the newest command for such a start was accepted: it is not rejected in the same step."""

    def clone(self) -> Self:
        """Return a copy."""
        changed = dict(self.rhythms), dict(self.waiting_ns), dict(self.taken_ns)
        return type(self)(self.rules, *changed)

    def comes(self, command: Command, instant_ns: int, now_ns: int) -> None:
        """Take a command's message into account."""
        if not self.rules.start_wait_ns or command.sent_ms is not None or not command.moves or command.rejected:
            return
        old = self.rhythms.get(command.key)
        if old is None or now_ns - old.last_ns >= self.rules.quiet_ns:
            old = Rhythm(now_ns, now_ns, LONG_AGO_NS, 0, 0, frozenset())
        apart_ns = instant_ns - old.instant_ns
        alone = apart_ns > 0 if command.verb is Verb.GET else apart_ns >= self.rules.apart_ns
        score = max(old.score - 1, 0) if alone else min(old.score + 3, self.rules.most_clumped)
        servos = old.servos | {servo_id for servo_id, _ in command.moves}
        self.rhythms[command.key] = Rhythm(old.first_ns, now_ns, instant_ns, old.messages + 1, score, servos)

    def begins(self, servo_id: int, command: Command, now_ns: int, *, waits: bool) -> None:
        """Let an accepted start or set of a servo that does not run wait; `waits`: an earlier start of it does."""
        earlier_ns = self.waiting_ns.pop(servo_id, now_ns - self.rules.silence_ns)
        since_ns = earlier_ns if waits else now_ns
        if self.rules.start_wait_ns and command.sent_ms is None:
            self.waiting_ns[servo_id], self.taken_ns[servo_id] = since_ns, now_ns
            if self.verdict(servo_id, now_ns) is True:
                del self.waiting_ns[servo_id]

    def verdict(self, servo_id: int, now_ns: int) -> bool | int:
        """Return whether the servo's start leaves (True) or is rejected (False), or when to look again."""
        since_ns = self.waiting_ns.get(servo_id)
        if since_ns is None:
            return True
        rules = self.rules
        known = [each for each in self.rhythms.values() if servo_id in each.servos or rules.starts_whole]
        known = [each for each in known if now_ns < each.last_ns + rules.quiet_ns]
        others = [each for each in known if each.last_ns > since_ns]
        least_ns = since_ns + (rules.silence_ns if others else rules.start_wait_ns)
        least_ns = max([least_ns, *(each.first_ns + rules.start_wait_ns for each in known)])
        clumps = [each for each in known if each.score > 0]
        silent_ns = max((each.last_ns + rules.silence_ns for each in clumps), default=now_ns)
        last_ns = max(min(silent_ns, since_ns + rules.proof_ns), self.taken_ns[servo_id] + 1)
        if now_ns < least_ns:
            return max(least_ns, last_ns) if clumps else least_ns
        if not clumps or (silent_ns <= now_ns and max(each.messages for each in clumps) <= 3):
            return True
        return last_ns if now_ns < last_ns else False

    def key(self, now_ns: int, waiting: Iterable[int]) -> tuple[object, ...]:
        """Return what still matters of it, if these servos wait to be started."""
        rhythms = ((name, each) for name, each in self.rhythms.items() if now_ns < each.last_ns + self.rules.quiet_ns)
        held = tuple(
            (servo_id, now_ns - self.waiting_ns[servo_id], self.taken_ns[servo_id] == now_ns)
            for servo_id in waiting
            if servo_id in self.waiting_ns
        )
        return tuple(sorted((name, *each.key(now_ns, self.rules)) for name, each in rhythms)), held
