"""What a judge of the supervisor remembers of messages without a time, and of the starts that wait for more of them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Self

from gateway.robot.core.events import Command
from gateway.robot.core.rules import Rules


@dataclass(slots=True)
class BacklogHistory:
    """When messages without a time came on each key, and which legs such a start of which key would energise."""

    rules: Rules
    came: dict[str, tuple[int, ...]] = field(default_factory=dict)
    bursts_ns: dict[str, int] = field(default_factory=dict)
    """When a key's latest burst was seen."""
    held: dict[int, str] = field(default_factory=dict)
    now_ns: int = 0

    def clone(self) -> Self:
        """A copy."""
        return type(self)(self.rules, dict(self.came), dict(self.bursts_ns), dict(self.held), self.now_ns)

    def comes(self, command: Command, now_ns: int) -> list[int]:
        """A command comes. Returns the legs whose waiting starts it shows to be of a burst."""
        self.now_ns = now_ns
        counts = command.sent_ms is None and command.moves and command.rejected is None
        if not self.rules.start_wait_ns or not counts:
            return []
        recent = [at for at in self.came.get(command.key, ()) if now_ns - at < self.rules.window_ns] + [now_ns]
        self.came[command.key] = tuple(recent)
        allowed = max(3, 2 + self.rules.window_ns // self.rules.period_ns)
        if len(recent) <= allowed:
            return []
        self.bursts_ns[command.key] = now_ns
        return [leg for leg, key in self.held.items() if key == command.key]

    def is_of_burst(self, command: Command) -> bool:
        """Whether a command is of a burst: a leg that does not run takes no start of it."""
        seen_ns = self.bursts_ns.get(command.key)
        return command.sent_ms is None and seen_ns is not None and self.now_ns - seen_ns < self.rules.timeout_ns

    def starts(self, command: Command, leg: int, *, armed: bool) -> bool:
        """A leg that does not run takes a start. Returns whether that has to wait from now on."""
        if command.sent_ms is not None:
            self.held.pop(leg, None)
        waits = bool(self.rules.start_wait_ns) and command.sent_ms is None and not armed
        if waits:
            self.held[leg] = command.key
        return waits

    def key(self, now_ns: int, waiting: Iterable[int]) -> tuple[object, ...]:
        """What still matters of it, where these legs wait to be started."""
        return backlog_key(
            self.rules, self.came, {key: at + self.rules.timeout_ns for key, at in self.bursts_ns.items()},
            self.held, now_ns, waiting,
        )  # fmt: skip


def backlog_key(
    rules: Rules,
    came: Mapping[str, tuple[int, ...]],
    until_ns: Mapping[str, int],
    held: Mapping[int, str],
    now_ns: int,
    waiting: Iterable[int],
) -> tuple[object, ...]:
    """What tells states apart: messages within the window, bursts that are not over, and who waits for what."""
    if not rules.start_wait_ns:
        return ()
    most = max(3, 2 + rules.window_ns // rules.period_ns)
    recent = {
        key: tuple(now_ns - at for at in times[-most:] if now_ns - at < rules.window_ns) for key, times in came.items()
    }
    return (
        tuple(sorted((key, ages) for key, ages in recent.items() if ages)),
        tuple(sorted((key, until - now_ns) for key, until in until_ns.items() if until > now_ns)),
        tuple((leg, held[leg]) for leg in sorted(waiting) if leg in held),
    )
