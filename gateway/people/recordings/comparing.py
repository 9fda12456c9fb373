"""Whether a gateway wrote what it was expected to write: frame by frame, and past each difference. Pure."""

from array import array
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Final, NamedTuple

from schemas.robot import LEGS

NS_PER_MS: Final = 1_000_000
NO_STEP: Final = -1
LOOK: Final = 200
"""So many frames of a leg are searched for the place where both go on alike: four seconds at 50 Hz."""
ALIKE: Final = 3
"""So many frames in a row are the same there: a gait has a pose more than once."""
APART_NS: Final = 10 * NS_PER_MS
"""Frames of the same bytes are taken for others where they are farther from their time, and a neighbour is nearer:
half a period at 50 Hz."""
RECENT: Final = 50
"""Frames by which it is known how long a leg's frames usually take."""


class Written(NamedTuple):
    """A frame on the wire: when, by the gateway's monotonic clock, and whether a command caused it."""

    at_ns: int
    data: bytes
    commanded: bool = True
    step: int = NO_STEP
    """Of an expected frame: the place of the step that causes it. What the gateway does by itself follows from the last
    step of that leg: so long after it comes the watchdog's Stop, or a Stop's repeat."""


class Frames:
    """Frames in few bytes: an hour of six legs at 50 Hz takes 35 MB, and as objects ten times that."""

    def __init__(self, frames: Sequence[Written] = ()) -> None:
        self.at_ns = array("q")
        self.commanded = bytearray()
        self.steps = array("l")
        self._data = bytearray()
        self._ends = array("Q", [0])
        for frame in frames:
            self.append(frame)

    def append(self, frame: Written) -> None:
        self.at_ns.append(frame.at_ns)
        self.commanded.append(frame.commanded)
        self.steps.append(frame.step)
        self._data += frame.data
        self._ends.append(len(self._data))

    def __len__(self) -> int:
        return len(self.at_ns)

    def data(self, place: int) -> bytes:
        """The bytes of a frame."""
        return bytes(self._data[self._ends[place] : self._ends[place + 1]])

    def frame(self, place: int) -> Written:
        """A frame as it was appended."""
        return Written(self.at_ns[place], self.data(place), bool(self.commanded[place]), self.steps[place])

    def leg(self, place: int) -> int:
        """The leg that a frame is for: its third byte is the id of its first servo."""
        return self._data[self._ends[place] + 2] // 10


class Sent:
    """When each step was handed to Zenoh: not before the one time and not after the other, on the recording's clock."""

    def __init__(self) -> None:
        self.begun_ns = array("q")
        self.done_ns = array("q")

    def append(self, begun_ns: int, done_ns: int) -> None:
        self.begun_ns.append(begun_ns)
        self.done_ns.append(done_ns)

    def __len__(self) -> int:
        return len(self.done_ns)


class Comparison(NamedTuple):
    """What a gateway wrote beside what it was expected to write."""

    frames: int
    """Expected."""
    same: int
    """Of these, those that were written: they are what the times are of."""
    differences: list[str]
    """A sentence for each leg whose frames are not the same bytes in the same order."""
    swapped: int
    """Commands' frames that another leg's frame overtook. The gateway's own are as punctual as its timers."""
    worst_ms: float
    p99_ms: float
    """How far frames are from their time, the way from here to the wire being that of most frames.

    A frame's time is counted from when its command was sent. So a sender that is late is not taken for a late gateway.
    """
    worst_at_s: float
    """When the frame that is farthest from its time was written in the recording."""
    beyond: int
    """Frames that are farther than the tolerance."""

    @property
    def passes(self) -> bool:
        """Same bytes, same order, times within the tolerance."""
        return not self.differences and self.swapped == 0 and self.beyond == 0


def compare(
    expected: Frames, recorded_ns: Sequence[int], sent: Sent, written: Frames, tolerance_ms: float
) -> Comparison:
    """Leg by leg, what commands caused and what the gateway did by itself; then the order of the commands' frames.

    `recorded_ns`: of each step, when the first of its frames was written in the recording.
    """
    lateness = _Lateness(expected, recorded_ns, sent, written)
    wanted, found = _sorted_out(expected), _sorted_out(written)
    differences: list[str] = []
    pairs: list[tuple[int, int]] = []
    for kind in wanted:
        matching = _Matching(lateness, wanted[kind], found[kind])
        pairs += matching.pairs
        if matching.first:
            differences.append(_sentence(kind, matching))
    pairs.sort()
    newest, swapped = -1, 0
    for want, have in pairs:
        if expected.commanded[want]:
            swapped += have < newest
            newest = max(newest, have)
    took = [lateness.between(want, have) for want, have in pairs]
    usual_ns = median(least_ns for least_ns, _ in took) if took else 0
    away = sorted(
        (max(0, least_ns - usual_ns, usual_ns - most_ns) / NS_PER_MS, expected.at_ns[want] / 1e9)
        for (least_ns, most_ns), (want, _) in zip(took, pairs, strict=True)
    ) or [(0.0, 0.0)]
    (worst_ms, worst_at_s), (p99_ms, _) = away[-1], away[len(away) * 99 // 100]
    beyond = sum(away_ms > tolerance_ms for away_ms, _ in away)
    return Comparison(len(expected), len(pairs), differences, swapped, worst_ms, p99_ms, worst_at_s, beyond)


class _Lateness(NamedTuple):
    """How much longer than in the recording a frame took from here to the wire, but for a constant."""

    expected: Frames
    recorded_ns: Sequence[int]
    sent: Sent
    written: Frames

    def between(self, want: int, have: int) -> tuple[int, int]:
        """At least, and at most."""
        after_ns = self.written.at_ns[have] - self.expected.at_ns[want]
        step = self.expected.steps[want]
        if not 0 <= step < len(self.sent):
            return after_ns, after_ns
        recorded_ns = self.recorded_ns[step]
        return after_ns - (self.sent.done_ns[step] - recorded_ns), after_ns - (self.sent.begun_ns[step] - recorded_ns)


_OfLeg = tuple[int, bool]
"""A leg, and whether commands caused it."""


def _sorted_out(frames: Frames) -> Mapping[_OfLeg, Sequence[int]]:
    """The places of each leg's frames."""
    found = {(leg, commanded): array("l") for leg in LEGS for commanded in (True, False)}
    for place in range(len(frames)):
        found[frames.leg(place), bool(frames.commanded[place])].append(place)
    return found


class _Matching:
    """Which of a leg's frames is which: the same bytes in the same order, past what is missing, added or different."""

    def __init__(self, lateness: _Lateness, wanted: Sequence[int], found: Sequence[int]) -> None:
        self._lateness = lateness
        self._expected, self._wanted = lateness.expected, wanted
        self._written, self._found = lateness.written, found
        self._usual_ns: int | None = None
        self._recent_ns: list[int] = []
        self._run_ends = 0, 0  # of the frames with the same bytes that were counted last
        self.pairs: list[tuple[int, int]] = []
        self.missing = self.added = self.changed = 0
        self.first = ""
        """The first difference in words."""
        self._match()

    def _match(self) -> None:
        at = of = 0
        while at < len(self._wanted) and of < len(self._found):
            if self._same(at, of):
                skip, extra = self._nearer(at, of)
                if not skip and not extra:
                    self._pair(at, of)
                    at, of = at + 1, of + 1
                    continue
            else:
                skip, extra = self._resume(at, of)
            self._differ(at, skip, of, extra)
            at, of = at + skip, of + extra
        self._differ(at, len(self._wanted) - at, of, len(self._found) - of)

    def _same(self, at: int, of: int) -> bool:
        return self._want(at) == self._have(of)

    def _want(self, at: int) -> bytes:
        return self._expected.data(self._wanted[at])

    def _have(self, of: int) -> bytes:
        return self._written.data(self._found[of])

    def _late_ns(self, at: int, of: int) -> int:
        """How far it would be from its usual time; 0 while nobody knows that time."""
        if self._usual_ns is None:
            return 0
        return self._lateness.between(self._wanted[at], self._found[of])[0] - self._usual_ns

    def _pair(self, at: int, of: int) -> None:
        self.pairs.append((self._wanted[at], self._found[of]))
        if self._usual_ns is None or len(self._recent_ns) < RECENT:
            self._recent_ns.append(self._lateness.between(self._wanted[at], self._found[of])[0])
            self._usual_ns = round(median(self._recent_ns))

    def _nearer(self, at: int, of: int) -> tuple[int, int]:
        """Where the same bytes come again and again: how many expected, or written, frames to leave out here.

        Only where there are not as many of them, and the frame behind it is nearer to its time as well; else this one
        was late.
        """
        away_ns = self._late_ns(at, of)
        if abs(away_ns) <= APART_NS or self._as_many(at, of):
            return 0, 0
        early = away_ns < 0
        for count in range(1, len(self._found) if early else len(self._wanted)):
            want, have = (at, of + count) if early else (at + count, of)
            if want >= len(self._wanted) or have >= len(self._found) or not self._same(want, have):
                break
            away_ns = self._late_ns(want, have)
            if abs(away_ns) <= APART_NS:
                last = want + 1 >= len(self._wanted) or have + 1 >= len(self._found)
                if last or abs(self._late_ns(want + 1, have + 1)) <= APART_NS:
                    return (0, count) if early else (count, 0)
            if (away_ns < 0) is not early:
                break
        return 0, 0

    def _as_many(self, at: int, of: int) -> bool:
        """Whether the same bytes come as often in both from here on."""
        if at >= self._run_ends[0] or of >= self._run_ends[1]:
            same, want, have = self._want(at), at, of
            while want < len(self._wanted) and self._want(want) == same:
                want += 1
            while have < len(self._found) and self._have(have) == same:
                have += 1
            self._run_ends = want, have
        return self._run_ends[0] - at == self._run_ends[1] - of

    def _resume(self, at: int, of: int) -> tuple[int, int]:
        """How many expected and how many written frames to leave out until both go on alike."""
        places: dict[bytes, list[int]] = {}
        for extra in range(min(LOOK, len(self._found) - of)):
            places.setdefault(self._have(of + extra), []).append(extra)
        nearest: tuple[int, int, int] | None = None
        for skip in range(min(LOOK, len(self._wanted) - at)):
            if nearest is not None and skip >= nearest[0]:
                break
            for extra in places.get(self._want(at + skip), ()):
                out_of_time = abs(self._late_ns(at + skip, of + extra)) > APART_NS
                found = skip + extra + out_of_time * 2 * LOOK, skip, extra
                if (nearest is None or found < nearest) and self._alike(at + skip, of + extra):
                    nearest = found
        return self._until_the_same_time(at, of) if nearest is None else nearest[1:]

    def _alike(self, at: int, of: int) -> bool:
        count = min(ALIKE, len(self._wanted) - at, len(self._found) - of)
        return all(self._same(at + each, of + each) for each in range(count))

    def _until_the_same_time(self, at: int, of: int) -> tuple[int, int]:
        """Where nothing is alike: what is earlier is left out; at the same time, a stretch of both."""
        skip = extra = 0
        if self._late_ns(at, of) > APART_NS:
            while at + skip < len(self._wanted) and self._late_ns(at + skip, of) > APART_NS:
                skip += 1
        elif self._late_ns(at, of) < -APART_NS:
            while of + extra < len(self._found) and self._late_ns(at, of + extra) < -APART_NS:
                extra += 1
        else:
            skip = extra = min(LOOK // 4, len(self._wanted) - at, len(self._found) - of)
        return skip, extra

    def _differ(self, at: int, skip: int, of: int, extra: int) -> None:
        changed = min(skip, extra)
        self.changed += changed
        self.missing += skip - changed
        self.added += extra - changed
        if self.first or not skip + extra:
            return
        if not skip:
            where = f"after {self._expected.at_ns[self._wanted[at - 1]] / 1e9:.3f} s " if at else ""
            self.first = f"{where}{self._have(of).hex()} was added"
            return
        self.first = f"at {self._expected.at_ns[self._wanted[at]] / 1e9:.3f} s "
        if extra:
            self.first += f"{self._have(of).hex()} was written in place of {self._want(at).hex()}"
        else:
            self.first += f"{self._want(at).hex()} is missing"


def _sentence(kind: _OfLeg, matching: _Matching) -> str:
    leg, commanded = kind
    counts = ((matching.missing, "missing"), (matching.added, "added"), (matching.changed, "different"))
    counted = ", ".join(f"{count} {word}" for count, word in counts if count)
    where = f"leg {leg}{'' if commanded else ', of its own'}"
    return f"{where}: {len(matching.pairs)} frames are the same, {counted}; the first: {matching.first}"
