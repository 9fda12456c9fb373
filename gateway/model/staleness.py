"""Detects commands that were delayed on their way (`limits.max_age_ms`), without synchronised clocks. Pure.

A command may have `sent_ms`, the time of its publisher's monotonic clock. That clock's zero is unknown, so a command's
*difference*, arrival - sent_ms, is its transit time plus an unknown constant. A clock's *baseline* is its smallest
difference, which means transit without delay. A command's delay is its difference minus the baseline.

- Burst after a stall: the queued commands arrive together, each with its own delay, and are rejected until the first
  fresh one. A burst follows a silence, so a silence does not erase the baseline.
- Drift: the baseline rises by 200 ppm, twice the error of a bad crystal. It falls at once, but by `FALL` of
  `max_age_ms` at most.
- Several clocks with one source: a source is only a name, which several programs may use, or one program before and
  after its restart. So each clock is kept apart and judges only its own commands. A command whose difference is below a
  clock's baseline is not that clock's. Commands of one clock arrive in order, so a command older than a clock's newest
  belongs to another clock, if one fits. A command that fits no clock is the first of a new clock, and fresh.
- Two similar clocks may both fit a command. Then two of them judge: the latest one and the one known for longest. The
  command is fresh if either finds it fresh. So a clock with a single command, forged or delayed, neither blocks another
  clock's commands nor admits old ones.
- An out-of-order command that is within `HORIZON_MS` of a clock may be an old one of that clock (two programs on one
  machine, one of which lost its link), and is judged as such.
- Steady delay: a clock may fall behind (the laptop slept or restarted), or transit may stay slower. Then all commands
  have the same delay, unlike commands from a queue that empties. After five seconds the delay becomes the baseline.
- Pauses of the gateway itself (a debugger, a frozen virtual machine): commands that waited in its rings and sockets
  seem to have just arrived. For `max_age_ms` after such a pause, a command is accepted only if a clock known from
  before finds it fresh. A pause is a gap between two calls of `record_alive`.

Memory is bounded. A source is forgotten only after a minute of silence, when any burst of it has arrived or is lost.
With all places taken, a new source is rejected, since its burst would look like fresh commands.
"""

import math
from dataclasses import dataclass
from operator import attrgetter
from typing import Final

SOURCES: Final = 256
CLOCKS: Final = 8
"""The most sources, and clocks of each: half a megabyte."""
FORGET_MS: Final = 60_000.0
HORIZON_MS: Final = 20_000.0
"""Zenoh closes a silent link after 10 s and drops what waits for it; a router on the way adds another 10 s."""
DRIFT: Final = 200e-6
FALL: Final = 0.25
"""The part of `max_age_ms` by which a clock's commands may be below its first baseline."""
STEADY_MS: Final = 5000.0
GAP_MS: Final = 1000.0
"""A longer gap between arrivals ends a stretch of steady delay, since another burst may follow."""
LEAST_PAUSE_MS: Final = 250.0
"""A shorter gap is no pause of the gateway: its loop turns every 100 ms, on a busy machine somewhat later."""


@dataclass(slots=True)
class _Stretch:
    """Late commands in a row: when the first and the last arrived, and the range of their differences."""

    begun_ms: float
    last_ms: float
    smallest_ms: float
    largest_ms: float
    overtaken: bool
    """Whether one of them arrived after a newer one, so that there may be two clocks."""


@dataclass(slots=True)
class _Clock:
    """One publisher's clock; differences are arrival - sent_ms."""

    baseline_ms: float
    highest_ms: float
    """The baseline from which `FALL` is counted: it rises as later commands confirm it, not in a silence."""
    since_ms: float
    fresh_ms: float
    newest_sent_ms: float
    newest_before_ms: float
    """The newest before this instant, since commands of one instant may arrive in any order."""
    stretch: _Stretch | None = None


class Staleness:
    """Judges the age of commands, by monotonic times only."""

    def __init__(self, max_age_ms: float) -> None:  # mutants accepted (Forget, Step): the first pause sets it
        self._max_age_ms = max_age_ms
        self.pause_ms = max(max_age_ms, LEAST_PAUSE_MS)
        """A longer gap between two calls counts as a pause of the gateway."""
        self._sources: dict[str | None, tuple[list[_Clock], list[float]]] = {}
        """Clocks and newest instant by source; the source that was silent for longest comes first."""
        self._alive_ms = math.inf
        self._woke_ms: float | None = None
        self._paused_ms = 0.0

    def record_alive(self, now_ns: int) -> None:
        """Record that the gateway runs. Call it at least twice in `pause_ms`: a longer gap counts as a pause."""
        self.too_old(None, None, now_ns, now_ns)

    # mutants accepted (Gt_GtE, Lt_LtE, Step): equal values; a list of one
    def too_old(  # noqa: PLR0912  (each setpoint takes this way, and a call fewer)
        self, name: str | None, sent_ms: float | None, now_ns: int, instant_ns: int
    ) -> str | None:
        """Return why a command is, or may be, older than allowed (one sentence), or None if it is accepted.

        `instant_ns` is when it was collected, together with others in unknown order.
        """
        now_ms, alive_ms = now_ns / 1e6, self._alive_ms
        self._alive_ms = now_ms
        if now_ms - alive_ms > self.pause_ms:
            self._woke_ms, self._paused_ms = now_ms, now_ms - alive_ms
        if sent_ms is None:
            return self._after_a_pause(now_ms, now_ms) if self._woke_ms is not None else None
        clocks = self._clocks_of(name, instant_ns / 1e6)
        if clocks is None:
            return (
                f"{SOURCES} sources have sent commands within {FORGET_MS / 1000:g} s, more than the gateway can track "
                "apart by their clocks; wait, or leave out sent_ms"
            )
        difference_ms = now_ms - sent_ms
        fitting: list[_Clock] = []
        in_order: list[_Clock] = []
        for clock in clocks:
            if difference_ms >= clock.highest_ms - FALL * self._max_age_ms:
                fitting += [clock]
                if sent_ms >= clock.newest_before_ms:
                    in_order += [clock]
        if in_order:
            clock = self._believed(in_order, difference_ms) if in_order[1:] else in_order[0]
        else:
            near = [clock for clock in fitting if difference_ms - clock.baseline_ms <= HORIZON_MS]
            if not near:
                return self._after_a_pause(self._new_clock(clocks, sent_ms, now_ms).since_ms, now_ms)
            clock = max(near, key=_latest)
        clock.newest_sent_ms = sent_ms if sent_ms > clock.newest_sent_ms else clock.newest_sent_ms
        clock.baseline_ms = difference_ms if difference_ms < clock.baseline_ms else clock.baseline_ms
        clock.highest_ms = clock.baseline_ms if clock.baseline_ms > clock.highest_ms else clock.highest_ms
        delay_ms = difference_ms - clock.baseline_ms
        if delay_ms > self._max_age_ms:
            if not self._is_steady(clock, difference_ms, now_ms, overtaken=not in_order):
                return f"the command was delayed for {delay_ms:.0f} ms; at most {self._max_age_ms:g} are allowed"
            clock = self._steady(clocks, clock, sent_ms, now_ms)
        elif in_order:
            clock.fresh_ms = now_ms
            if clock.stretch is not None and not clock.stretch.overtaken:
                clock.stretch = None
        return None if self._woke_ms is None else self._after_a_pause(clock.since_ms, now_ms)

    def _after_a_pause(self, known_since_ms: float, now_ms: float) -> str | None:
        """Return why a command is rejected soon after a pause of the gateway, unless its clock is known from before."""
        if self._woke_ms is None or known_since_ms < self._woke_ms or now_ms - self._woke_ms > self._max_age_ms:
            return None
        return (
            f"the gateway itself was stopped for {self._paused_ms:.0f} ms, so the command may have waited in it; "
            f"for {self._max_age_ms:g} ms only those are accepted whose sent_ms shows that they are fresh"
        )

    # mutants accepted (Step): a list of one
    def _clocks_of(self, name: str | None, instant_ms: float) -> list[_Clock] | None:
        """Return the known clocks of a source, as of this instant, or None if there is no place for a new source."""
        source = self._sources.pop(name, None)
        if source is None:
            if len(self._sources) >= SOURCES:
                oldest = next(iter(self._sources))
                if instant_ms - self._sources[oldest][1][0] < FORGET_MS:
                    return None
                del self._sources[oldest]
            source = ([], [instant_ms])
        self._sources[name] = source  # at the end
        clocks, newest = source
        if instant_ms > newest[0]:
            rise_ms, newest[0] = DRIFT * (instant_ms - newest[0]), instant_ms
            for clock in clocks:
                clock.baseline_ms += rise_ms
                clock.newest_before_ms = clock.newest_sent_ms
        return clocks

    def _believed(self, clocks: list[_Clock], difference_ms: float) -> _Clock:
        last, longest = max(clocks, key=_latest), max(clocks, key=_proven)
        late = difference_ms - last.baseline_ms > self._max_age_ms
        return longest if late and difference_ms - longest.baseline_ms <= self._max_age_ms else last

    def _new_clock(self, clocks: list[_Clock], sent_ms: float, now_ms: float) -> _Clock:
        if len(clocks) == CLOCKS:
            clocks.remove(min(clocks, key=_proven))
        difference_ms = now_ms - sent_ms
        clock = _Clock(difference_ms, difference_ms, now_ms, now_ms, sent_ms, sent_ms)
        clocks.append(clock)
        return clock

    def _steady(self, clocks: list[_Clock], clock: _Clock, sent_ms: float, now_ms: float) -> _Clock:
        """Take a steady delay as another clock's, or as this clock's new baseline. Return the clock."""
        stretch, clock.stretch = clock.stretch, None
        if stretch is not None and stretch.overtaken:
            return self._new_clock(clocks, sent_ms, now_ms)
        clock.baseline_ms = clock.highest_ms = now_ms - sent_ms
        clock.fresh_ms = now_ms
        return clock

    def _is_steady(self, clock: _Clock, difference_ms: float, now_ms: float, *, overtaken: bool) -> bool:
        stretch = clock.stretch
        if stretch is not None and now_ms - stretch.last_ms <= GAP_MS:
            stretch.last_ms = now_ms
            stretch.overtaken = stretch.overtaken or overtaken
            stretch.smallest_ms = min(stretch.smallest_ms, difference_ms)
            stretch.largest_ms = max(stretch.largest_ms, difference_ms)
            if stretch.largest_ms - stretch.smallest_ms <= self._max_age_ms:
                return now_ms - stretch.begun_ms >= STEADY_MS
        clock.stretch = _Stretch(now_ms, now_ms, difference_ms, difference_ms, overtaken)
        return False


_latest = attrgetter("fresh_ms")


def _proven(clock: _Clock) -> tuple[float, float]:
    """How long the clock has sent fresh commands, at most `STEADY_MS`; of equal ones the latest counts."""
    return min(clock.fresh_ms - clock.since_ms, STEADY_MS), clock.fresh_ms
