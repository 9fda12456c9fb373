"""When a leg may send next, and what it will send then: pure, in nanoseconds of the monotonic clock.

A leg has turns, one period apart. A command that finds its turn open goes out at once and takes the turn; one that
comes sooner waits, and only the newest target of each servo is kept. Missed turns are skipped, never made up in a
burst, and the turns after them stay on their grid, so that a stream at just the limit's rate does not fall behind by
its own worst jitter or stall. The grid starts again only with the first frame for a leg at rest.

Two frames are never less than half a period apart.

Stop frames know no turns and never pass through here.
"""

from dataclasses import dataclass, field
from typing import Final, NamedTuple

from gateway.protocol.frames import Op, ServoOp

NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000

EARLY_SHARE: Final = 2
"""A turn opens half a period early for a leg with nothing waiting. A stream at just the limit's rate sets the grid with
its first frame, and if that one was late by some milliseconds, then every later one comes too early by as much, and
would wait for as long as the stream lasts: with a tenth of a period here, publish → transfer was 3 to 13 ms in a third
of the benchmark's rounds, with half a period 0.6 to 0.9 ms in all of them. A leg that is sent more than its rate always
has something waiting, so it never gains by this."""


class Waiting(NamedTuple):
    """A servo's newest target, and the command (by its order number) that set it."""

    op: ServoOp
    order: int


def merged(older: ServoOp, newer: ServoOp) -> ServoOp:
    """The newest target; a start that waits keeps being a start when only its angle changes."""
    if older.op is Op.START and newer.op is Op.SET:
        return ServoOp(Op.START, newer.angle_cdeg)
    return newer


@dataclass(slots=True)
class Turn:
    """The turns of one leg."""

    period_ns: int
    next_ns: int = 0
    last_ns: int = -NS_PER_S  # half of the longest period and more, before anything

    def is_open(self, now_ns: int, *, something_waits: bool) -> bool:
        """Whether a frame may go out now."""
        early_ns = 0 if something_waits else self.period_ns // EARLY_SHARE
        return now_ns >= max(self.next_ns - early_ns, self.last_ns + self.period_ns // 2)

    def take(self, now_ns: int, *, at_rest: bool) -> None:
        """A frame goes out now, perhaps the first for a leg at rest: skip what was missed and set the next turn.

        Were the grid to start again after each missed turn, it would often be just ahead of the stream that goes on,
        and every later setpoint would wait for nearly a period.
        """
        missed = max(0, (now_ns - self.next_ns) // self.period_ns)
        turn_ns = now_ns if at_rest and missed else self.next_ns + missed * self.period_ns
        self.next_ns = max(turn_ns + self.period_ns, now_ns + self.period_ns // 2)
        self.last_ns = now_ns


@dataclass(slots=True)
class StartQueue:
    """Legs that wait to be energised, in order, at least `pause_ns` apart; 0 lets all go at once.

    Eighteen servos that draw their starting current in one instant can pull the supply down.
    """

    pause_ns: int
    next_ns: int = 0
    legs: list[int] = field(default_factory=list)

    def join(self, leg: int) -> None:
        """`leg` wants to be energised; a leg that waits already keeps its place."""
        if self.pause_ns and leg not in self.legs:
            self.legs.append(leg)

    def admits(self, leg: int, now_ns: int) -> bool:
        """Whether `leg`, which has joined, may be energised now."""
        return self.pause_ns == 0 or (self.legs[0] == leg and now_ns >= self.next_ns)

    def started(self, leg: int, now_ns: int) -> None:
        """`leg` is being energised now."""
        self.leave(leg)
        self.next_ns = now_ns + self.pause_ns

    def leave(self, leg: int) -> None:
        """`leg` waits no more to be energised."""
        if leg in self.legs:
            self.legs.remove(leg)

    def turn_ns(self, leg: int, leg_turn_ns: int) -> int | None:
        """When to look at a waiting leg again; None: the leg before it in the queue comes first."""
        if leg not in self.legs:
            return leg_turn_ns
        return max(leg_turn_ns, self.next_ns) if self.legs[0] == leg else None
