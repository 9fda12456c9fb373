"""Whether a simulated robot went where it was sent, from what a walker sends: figures, and their limits."""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from gateway.people.walking.motion import travelled
from tests.walking.physics import Assumed, Track, World, went
from tests.walking.recorded import Recording, Walked

OFF: Final = 0.10
"""Of the distance that was commanded."""
ASIDE: Final = 0.05
"""Of the way."""
TURNED_DEG: Final = 5.0
TILT_DEG: Final = 5.0
SCRAPED_M: Final = 0.010
SHORT_M: Final = 0.006
"""A way of a few centimetres says little of what a robot drifts on a long one: standing up shifts it by as much."""
_ARM_M: Final = 0.3
"""A turn on the spot carries the feet along a circle of about this radius: its way, for what it drifts."""


class Result(NamedTuple):
    """One part of a course in one simulated world."""

    gait: str
    part: str
    assumed: Assumed
    wanted_m: float
    went_m: float
    """Along the line from the beginning to the end that was commanded."""
    aside_m: float
    """From that line; of a turn on the spot, from the spot."""
    way_m: float
    turned_wrong_deg: float
    tilt_deg: float
    scraped_m: float

    @property
    def faults(self) -> list[str]:
        """What is not within the limits, in words."""
        found = []
        if abs(self.went_m - self.wanted_m) > max(OFF * self.wanted_m, SHORT_M):
            found.append(f"went {self.went_m:.3f} m of {self.wanted_m:.3f}")
        if self.aside_m > max(ASIDE * self.way_m, SHORT_M):
            found.append(f"{1000 * self.aside_m:.0f} mm aside on a way of {self.way_m:.2f} m")
        if abs(self.turned_wrong_deg) > TURNED_DEG:
            found.append(f"heading off by {self.turned_wrong_deg:+.1f} degrees")
        if self.tilt_deg > TILT_DEG:
            found.append(f"leaned by {self.tilt_deg:.1f} degrees")
        if self.scraped_m > SCRAPED_M:
            found.append(f"a foot scraped by {1000 * self.scraped_m:.1f} mm")
        return [f"{self.gait}, {self.part}, {self.assumed}: {fault}" for fault in found]


class Verdict(NamedTuple):
    """A whole course in one world."""

    results: list[Result]
    track: Track
    faults: list[str]


def judge(recording: Recording, assumed: Assumed) -> Verdict:
    """Stand up, the parts, sit down."""
    track = World(assumed).run(recording.sent)
    results = [_result(recording.gait, walked, track, assumed) for walked in recording.parts]
    faults = [fault for result in results for fault in result.faults]
    if track.fell:
        faults.append(f"{recording.gait}, {assumed}: it fell")
    return Verdict(results, track, faults)


def _result(gait: str, walked: Walked, track: Track, assumed: Assumed) -> Result:
    ahead_m, left_m, turned_deg = went(track.at(walked.begin_s), track.at(walked.end_s))
    velocity = walked.part.velocity
    x_m, y_m, turned_rad = travelled(velocity, walked.held_s)
    wanted_m = math.hypot(x_m, y_m)
    way_m = walked.held_s * max(math.hypot(velocity.forward_m_s, velocity.left_m_s), abs(velocity.turn_rad_s) * _ARM_M)
    if wanted_m:
        went_m = (ahead_m * x_m + left_m * y_m) / wanted_m
        aside_m = abs(ahead_m * y_m - left_m * x_m) / wanted_m
    else:
        went_m, aside_m = 0.0, math.hypot(ahead_m, left_m)
    return Result(
        gait=gait,
        part=walked.part.name,
        assumed=assumed,
        wanted_m=wanted_m,
        went_m=went_m,
        aside_m=aside_m,
        way_m=way_m,
        turned_wrong_deg=turned_deg - math.degrees(turned_rad),
        tilt_deg=track.tilt_deg(walked.begin_s, walked.end_s),
        scraped_m=track.scraped_m(walked.begin_s, walked.end_s),
    )


def table(results: Sequence[Result]) -> str:
    """Lines of a table: of each gait and part, what was wanted and the range over all worlds."""
    lines = [f"{'gait':7} {'part':15} {'wanted':>7} {'went':>13} {'aside':>8} {'heading':>13} {'tilt':>6} {'slip':>6}"]
    for gait, part in dict.fromkeys((result.gait, result.part) for result in results):
        same = [result for result in results if (result.gait, result.part) == (gait, part)]
        ways = [result.went_m for result in same]
        turns = [result.turned_wrong_deg for result in same]
        lines.append(
            f"{gait:7} {part:15} {same[0].wanted_m:6.2f}m {min(ways):5.2f} … {max(ways):4.2f}m "
            f"{1000 * max(result.aside_m for result in same):6.0f}mm {min(turns):+5.1f} … {max(turns):+4.1f}° "
            f"{max(result.tilt_deg for result in same):5.1f}° {1000 * max(result.scraped_m for result in same):4.1f}mm"
        )
    return "\n".join(lines)
