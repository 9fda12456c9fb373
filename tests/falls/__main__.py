"""`make falls`: each gait and a stand, stopped in every way in 24 phases of the stride; a table."""

import sys
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import reduce
from itertools import product
from pathlib import Path
from typing import Final, NamedTuple

from gateway.people.physics.assumed import Assumed
from tests.falls.fall import Fall, fall
from tests.falls.stride import PHASES, SETTINGS, STANCES, moments
from tests.falls.ways import WAYS

WORLDS: Final = {
    "as assumed": Assumed(),
    "servos of 1.4 N·m": Assumed(torque_nm=1.4),
    "3.5 kg": Assumed(mass_kg=3.5),
    "5.0 kg, servos of 3.5 N·m": Assumed(mass_kg=5.0, torque_nm=3.5),
    "friction 0.5": Assumed(friction=0.5),
}
"""The last but one is what the Elkapod's own description adds up to, with servos that carry it."""
USUAL: Final = "as assumed"
LANDING: Final = "landing"
MOST_SPEED_M_S: Final = 0.2
MOST_TILT_DEG: Final = 10.0
"""What a landing may do."""
STUCK_M_S: Final = 0.8
STUCK: Final = {("servos of 1.4 N·m", "tripod"), ("3.5 kg", "tripod")}
"""Servos too weak for their robot to push a loaded foot outward over rubber: from some phases of a tripod walk two feet
hold it up like a trestle, and let go at once (docs/stops.md)."""


class Row(NamedTuple):
    """One stance, one way of stopping, one world: the fall in each phase."""

    world: str
    stance: str
    way: str
    falls: list[Fall]

    @property
    def worst(self) -> Fall:
        """Each figure's worst."""
        return reduce(Fall.worse, self.falls)


def rows(world: str, stance: str, phases: int = PHASES) -> list[Row]:
    """Every way of stopping."""
    found = moments(stance, WORLDS[world], phases)
    return [Row(world, stance, way.name, [fall(each, way, SETTINGS) for each in found]) for way in WAYS]


def table(found: Iterable[Row]) -> str:
    """Of all phases the worst of each figure."""
    lines = [
        "| stands or walks | stopped by | drop | fastest down | worst tilt | fell over | energy |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in found:
        worst = row.worst
        over = f"{sum(each.fell_over for each in row.falls)} of {len(row.falls)}"
        lines.append(
            f"| {row.stance} | {row.way} | {1000 * worst.drop_m:.0f} mm | {worst.speed_m_s:.2f} m/s "
            f"| {worst.tilt_deg:.1f}° | {over} | {worst.energy_j:.2f} J |"
        )
    return "\n".join(lines)


def most_speed_m_s(world: str, stance: str) -> float:
    """What a landing may do there."""
    return STUCK_M_S if (world, stance) in STUCK else MOST_SPEED_M_S


def faults(found: Iterable[Row]) -> list[str]:
    """Landings that are harder than the pages state."""
    return [
        f"{row.world}, {row.stance}, landing: {row.worst.speed_m_s:.2f} m/s, {row.worst.tilt_deg:.1f} degrees"
        for row in found
        if row.way == LANDING
        and (row.worst.speed_m_s >= most_speed_m_s(row.world, row.stance) or row.worst.tilt_deg >= MOST_TILT_DEG)
    ]


def main() -> int:
    """All of it."""
    with ProcessPoolExecutor() as processes:
        found = [row for part in processes.map(rows, *zip(*product(WORLDS, STANCES), strict=True)) for row in part]
    text = []
    for world in WORLDS:
        text.append(f"### {world[0].upper()}{world[1:]}\n\n{table(row for row in found if row.world == world)}\n")
    folder = Path("build")
    folder.mkdir(exist_ok=True)
    (folder / "falls.md").write_text("\n".join(text))
    print("\n".join(text))
    print("build/falls.md")
    too_hard = faults(found)
    for each in too_hard:
        print(each)
    return 1 if too_hard else 0


if __name__ == "__main__":
    sys.exit(main())
