"""One fall: what becomes of a robot that is stopped, in figures; and what a landing sends it."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple

from gateway.geometry import Geometry
from gateway.people.physics.world import TIMESTEP_S, World
from gateway.robot.core.landing import landing
from gateway.robot.settings import Settings
from schemas.robot import SERVO_IDS
from tests.walking.physics import Sent, drive

AFTER_S: Final = 1.5
"""After the last thing that is sent: then it lies."""
SLACK: Final[Mapping[int, float | None]] = dict.fromkeys(SERVO_IDS)
_LOOK: Final = 5
"""Steps."""
_NS: Final = 1_000_000_000


class Fall(NamedTuple):
    """Of a robot that stood or walked, from its latest command on."""

    drop_m: float
    speed_m_s: float
    """The fastest that its body went down."""
    tilt_deg: float

    def worse(self, other: "Fall") -> "Fall":
        """The worse of each figure."""
        return Fall(*map(max, self, other))


def looked_at(world: World, sent: Iterable[Sent], geometry: Geometry) -> Fall:
    """Send the servos there, in seconds from now, and look until it lies."""
    begun_s, begin = world.time_s, world.body()
    lowest_m, speed_m_s, tilt_deg = begin.position_m[2], 0.0, 0.0
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
    return Fall(begin.position_m[2] - lowest_m, speed_m_s, tilt_deg)


def landed(begin: Mapping[int, float], settings: Settings) -> Iterator[Sent]:
    """A landing from these angles by the core's own function, at the legs' rate. Seconds from the latest command."""
    began_ns = round(settings.watchdog.timeout_ms * 1e6)
    length_ns = round(settings.watchdog.landing_ms * 1e6)
    period_ns = round(_NS / settings.limits.leg_rate_hz)
    ends = {int(name): angle_deg for name, angle_deg in settings.watchdog.landing.items()}
    ways_cdeg = {
        servo_id: (round(100 * angle_deg), round(100 * ends.get(servo_id, angle_deg)))
        for servo_id, angle_deg in begin.items()
    }
    way = landing(began_ns, began_ns + length_ns, length_ns, period_ns, ways_cdeg)
    now_ns, part_ns = began_ns, 0
    while now_ns < way.ends_ns and part_ns < way.length_ns:
        part_ns = way.next_part_ns(part_ns, now_ns)
        yield now_ns / _NS, {servo_id: way.angle_cdeg(servo_id, part_ns) / 100 for servo_id in ways_cdeg}
        now_ns += period_ns
    yield way.ends_ns / _NS, SLACK
