"""Which output of the power board feeds a servo: the one whose current rises while the servo moves. Pure.

The board's currents come under the names that `power.servos` gives to its outputs, so another name than the servo's own
shows that two of its entries are wrong.
"""

import re
import tomllib
from collections.abc import Mapping
from typing import Final, NamedTuple

from schemas.robot import SERVO_IDS
from schemas.telemetry import Telemetry

LEAST_RISE_A: Final = 0.05
"""A servo at rest draws some 8 mA, one that moves at least 100: less shows nothing."""
CLEAR: Final = 2.0
"""So many times the rise of any other output: legs that touch each other draw together."""


class ServoCurrents:
    """The highest current under each name, at rest and from `moves` on, in A."""

    def __init__(self) -> None:
        """At rest."""
        self.rest: dict[str, float] = {}
        self.moving: dict[str, float] = {}
        self._seen = self.rest

    def moves(self) -> None:
        """The servo is started now."""
        self._seen = self.moving

    def take(self, telemetry: Telemetry) -> None:
        """What the board measured."""
        for name, servo in (telemetry.servos or {}).items():
            if servo.current_a is not None:
                self._seen[name] = max(servo.current_a, self._seen.get(name, 0.0))


class ServoOutput(NamedTuple):
    """What the currents show of a servo."""

    sentence: str
    """It names what is uncertain."""
    hangs_on: int | None = None
    """The servo to which power.servos gives its output; None: its own, or not known."""


def finding(servo_id: int, rest: Mapping[str, float], moving: Mapping[str, float]) -> ServoOutput:
    """Where this servo hangs, and what that rests on."""
    rises = {name: now - rest[name] for name, now in moving.items() if name in rest}
    first, second = [*sorted(rises, key=rises.__getitem__, reverse=True), "", ""][:2]
    if not first or rises[first] < LEAST_RISE_A:
        return ServoOutput(
            f"The power board has measured no current of servo {servo_id}: which output feeds it is not known. Does "
            "the board feed it at all?"
        )
    shown = f"{rises[first] * 1000:.0f} mA more than at rest"
    if second and rises[first] < CLEAR * rises[second]:
        return ServoOutput(
            f"Uncertain: servos {first} and {second} of power.servos drew more while servo {servo_id} moved. Lift the "
            "robot so that nothing touches, and do this again."
        )
    if first == str(servo_id):
        return ServoOutput(f"The power board's output for servo {servo_id} feeds it ({shown}).")
    return ServoOutput(
        f"power.servos is WRONG: servo {servo_id} hangs on the output that it gives to servo {first} ({shown}). "
        f"Exchange the two there, restart the gateway, and do this again with servo {first}: a Stop that is confirmed "
        "for one servo would concern another.",
        int(first),
    )


def exchanged(text: str, one: int, other: int) -> str:
    """This configuration file with two servos of power.servos exchanged, and all else as it was.

    Raises ValueError where it has no table [power], or states power.servos in a way that is not found.
    """
    stated = tomllib.loads(text).get("power", {}).get("servos") or list(SERVO_IDS)
    swap = {one: other, other: one}
    line = f"servos = {[swap.get(each, each) for each in stated]}"
    header = re.search(r"^\[power\][^\n]*\n", text, re.MULTILINE)
    if header is None:
        raise ValueError("it has no line [power]")
    begin = header.end()
    following = re.search(r"^\[", text[begin:], re.MULTILINE)
    end = begin + following.start() if following else len(text)
    table, found = re.subn(r"^servos\s*=\s*\[[^\]]*\]", line, text[begin:end], count=1, flags=re.MULTILINE)
    new = text[:begin] + (table if found else f"{line}\n{table}") + text[end:]
    if tomllib.loads(new)["power"]["servos"] != [swap.get(each, each) for each in stated]:
        raise ValueError("power.servos is stated in a way that is not understood")
    return new
