"""How far a servo may go with one frame, where its speed is limited. Pure."""

from typing import NamedTuple

from gateway.allowance import NS_PER_S


class Step(NamedTuple):
    """What a frame may say, and from when on the next one counts."""

    angle_cdeg: int
    since_ns: int


def step(from_cdeg: int, to_cdeg: int, speed_cdeg_s: int, since_ns: int, now_ns: int, period_ns: int) -> Step:
    """One step from an angle towards another, at most speed times time since `since_ns`, and speed times a rate slot.

    Time beyond a rate slot is lost: after a stall, or after a long time without a command, a servo would else leap.

    Whole hundredths of a degree only. The time that a hundredth took counts as used, and the rest is left for the next
    step: else a slow servo whose leg gets many frames would never move.
    """
    most_cdeg = speed_cdeg_s * (now_ns - since_ns) // NS_PER_S
    slot_cdeg = -(-speed_cdeg_s * period_ns // NS_PER_S)  # rounded up: at least a hundredth
    way_cdeg = to_cdeg - from_cdeg
    if abs(way_cdeg) <= min(most_cdeg, slot_cdeg):
        return Step(to_cdeg, now_ns)
    if most_cdeg > slot_cdeg:
        return Step(from_cdeg + (slot_cdeg if way_cdeg > 0 else -slot_cdeg), now_ns)
    used_ns = -(-most_cdeg * NS_PER_S // speed_cdeg_s)  # rounded up: never faster, by no nanosecond
    return Step(from_cdeg + (most_cdeg if way_cdeg > 0 else -most_cdeg), since_ns + used_ns)
