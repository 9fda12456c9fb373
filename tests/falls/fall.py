"""One fall: what becomes of a robot that is stopped, in figures."""

from collections.abc import Iterable
from copy import deepcopy
from typing import Final, NamedTuple

from gateway.geometry import Geometry
from gateway.people.physics.model import TIMESTEP_S
from gateway.people.physics.world import World
from gateway.robot.settings import Settings
from tests.falls.stride import GEOMETRY, Moment
from tests.falls.ways import Way
from tests.walking.physics import Sent, drive

AFTER_S: Final = 1.5
"""After the last thing that is sent: then it lies."""
_LOOK: Final = 5
"""Steps."""


class Fall(NamedTuple):
    """Of a robot that stood or walked, from its latest command on."""

    drop_m: float
    speed_m_s: float
    """The fastest that its body went down."""
    tilt_deg: float
    fell_over: bool
    energy_j: float
    """Of its mass at that speed."""

    def worse(self, other: "Fall") -> "Fall":
        """The worse of each figure."""
        return Fall(
            max(self.drop_m, other.drop_m),
            max(self.speed_m_s, other.speed_m_s),
            max(self.tilt_deg, other.tilt_deg),
            self.fell_over or other.fell_over,
            max(self.energy_j, other.energy_j),
        )


def fall(moment: Moment, way: Way, settings: Settings) -> Fall:
    """Stop it so, and look until it lies."""
    return looked_at(deepcopy(moment.world), way.sent(moment, settings))


def looked_at(world: World, sent: Iterable[Sent], geometry: Geometry = GEOMETRY) -> Fall:
    """Send the servos there, in seconds from now."""
    begun_s, begin = world.time_s, world.body()
    lowest_m, speed_m_s, tilt_deg, upright = begin.position_m[2], 0.0, 0.0, True
    waiting = list(sent)
    last_s = waiting[-1][0]
    steps = 0
    while world.time_s - begun_s < last_s + AFTER_S:
        while waiting and waiting[0][0] <= world.time_s - begun_s + TIMESTEP_S / 2:
            drive(world, waiting.pop(0)[1], geometry)
        world.step()
        steps += 1
        speed_m_s = max(speed_m_s, -float(world.data.qvel[2]))
        if steps % _LOOK == 0:
            body = world.body()
            lowest_m, tilt_deg = min(lowest_m, body.position_m[2]), max(tilt_deg, body.tilt_deg)
            upright = upright and body.upright
    mass_kg = float(sum(world.model.body_mass))
    return Fall(begin.position_m[2] - lowest_m, speed_m_s, tilt_deg, not upright, mass_kg * speed_m_s**2 / 2)
