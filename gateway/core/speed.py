"""How far a servo may go with one frame, where its speed is limited. Pure."""

from typing import NamedTuple

from gateway.core.pacing import NS_PER_S


class Step(NamedTuple):
    """What a frame may say, and from when on the next one counts."""

    angle_cdeg: int
    since_ns: int


def step(from_cdeg: int, to_cdeg: int, speed_cdeg_s: int, since_ns: int, now_ns: int) -> Step:
    """One step from an angle towards another, at most speed times time since `since_ns`.

    Whole hundredths of a degree only. The time that a hundredth took counts as used, and the rest is left for the next
    step: else a slow servo whose leg gets many frames would never move.
    """
    most_cdeg = speed_cdeg_s * (now_ns - since_ns) // NS_PER_S
    way_cdeg = to_cdeg - from_cdeg
    if abs(way_cdeg) <= most_cdeg:
        return Step(to_cdeg, now_ns)
    used_ns = -(-most_cdeg * NS_PER_S // speed_cdeg_s)  # rounded up: never faster, by no nanosecond
    return Step(from_cdeg + (most_cdeg if way_cdeg > 0 else -most_cdeg), since_ns + used_ns)
