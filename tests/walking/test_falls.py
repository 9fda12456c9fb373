"""What stops do to a robot (docs/stops.md). That a gateway writes a landing as computed: tests/hil/test_landing.py."""

import tomllib
from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from functools import cache, reduce
from itertools import product
from pathlib import Path
from typing import Final, NamedTuple

import pytest

from gateway.geometry import load
from gateway.model.angle_limits import AngleLimits
from gateway.people.physics.assumed import Assumed
from gateway.people.physics.world import TIMESTEP_S, World
from gateway.people.walking.engine import Engine
from gateway.people.walking.gaits import GAITS
from gateway.people.walking.motion import Velocity
from gateway.people.walking.robot import Robot
from gateway.robot.core.pace import Paces
from gateway.robot.core.rules import Rules
from gateway.robot.core.servo import RUNNING, Servo
from gateway.robot.settings import Settings
from schemas.robot import SERVO_IDS
from tests.walking import physics

ELKAPOD: Final = Path(__file__).parents[2] / "examples" / "elkapod"
GEOMETRY: Final = load(ELKAPOD / "geometry.json")
"""Angles as commands name them, the same on both sides; so is the landing pose."""
SETTINGS: Final = Settings.of(tomllib.loads((ELKAPOD / "gateway.toml").read_text()))
PHASES: Final = 6
STAND: Final = "stand"
STANCES: Final = (STAND, *GAITS)
_STRIDES_BEFORE: Final = 2


@cache
def moments(stance: str, assumed: Assumed) -> list[tuple[World, dict[int, float]]]:
    """Return a robot in each phase of a stride (a stand has one), just after a command, and the commanded angles.

    These are in degrees as commands name them. Copy a world before use.
    """
    engine = Engine(Robot(GEOMETRY), "tripod" if stance == STAND else stance)
    world = physics.stood_up(engine, assumed)
    if stance == STAND:
        return [(world, physics.angles_of(engine))]
    ticks = round(GAITS[stance].period_s / physics.TICK_S)
    due = {_STRIDES_BEFORE * ticks + round(phase * ticks / PHASES) for phase in range(PHASES)}
    found = []
    for number in range((_STRIDES_BEFORE + 1) * ticks):
        physics.walk(world, engine, Velocity(physics.SPEEDS_M_S[stance]))
        if number in due:
            found.append((deepcopy(world), physics.angles_of(engine)))
    return found


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
        """Return the worse of each figure."""
        return Fall(*map(max, self, other))


def looked_at(world: World, sent: Iterable[physics.Sent]) -> Fall:
    """Send the servos there, in seconds from now, and look until it lies."""
    begun_s, begin = world.time_s, world.body()
    lowest_m, speed_m_s, tilt_deg = begin.position_m[2], 0.0, 0.0
    waiting = list(sent)
    last_s = waiting[-1][0]
    steps = 0
    while world.time_s - begun_s < last_s + AFTER_S:
        while waiting and waiting[0][0] <= world.time_s - begun_s + TIMESTEP_S / 2:
            physics.drive(world, waiting.pop(0)[1], GEOMETRY)
        world.step()
        steps += 1
        speed_m_s = max(speed_m_s, -float(world.data.qvel[2]))
        if steps % _LOOK == 0:
            body = world.body()
            lowest_m, tilt_deg = min(lowest_m, body.position_m[2]), max(tilt_deg, body.tilt_deg)
    return Fall(begin.position_m[2] - lowest_m, speed_m_s, tilt_deg)


def landed(begin: Mapping[int, float]) -> Iterator[physics.Sent]:
    """Land from these angles by the core's own function, at the legs' rate. Times are since the latest command."""
    began_ns = round(SETTINGS.watchdog.timeout_ms * 1e6)
    length_ns = round(SETTINGS.watchdog.landing_ms * 1e6)
    period_ns = round(_NS / SETTINGS.limits.leg_rate_hz)
    ends = {int(name): angle_deg for name, angle_deg in SETTINGS.watchdog.landing.items()}
    pace = Paces(Rules(period_ns=period_ns, landing_ns=length_ns), AngleLimits())
    servos = [Servo(servo_id, RUNNING, round(100 * angle_deg)) for servo_id, angle_deg in begin.items()]
    for servo in servos:
        pace.land(servo, round(100 * ends.get(servo.servo_id, begin[servo.servo_id])), began_ns)
    for now_ns in range(began_ns, began_ns + length_ns, period_ns):
        yield (
            now_ns / _NS,
            {each.servo_id: pace.step(each, now_ns, 0, lands=True).angle_cdeg / 100 for each in servos if each.target},
        )
    yield (began_ns + length_ns) / _NS, SLACK


WEAK: Final = "servos of 1.4 N·m"
WORLDS: Final = {
    "as assumed": Assumed(),
    WEAK: Assumed(torque_nm=1.4),
    "3.5 kg": Assumed(mass_kg=3.5),
    "5.0 kg, servos of 3.5 N·m": Assumed(mass_kg=5.0, torque_nm=3.5),
    "friction 0.5": Assumed(friction=0.5),
}
"""The last but one is what the Elkapod's own description adds up to, with servos that carry it."""
HARDEST: Final = (STAND, "tripod")
"""The fewest feet carry a tripod; the gaits with more of them go in two worlds only."""
MOST_SPEED_M_S: Final = 0.2
MOST_TILT_DEG: Final = 10.0
"""What a landing may do."""
STUCK_M_S: Final = 0.8
STUCK: Final = {(WEAK, "tripod"), ("3.5 kg", "tripod")}
"""Servos too weak for their robot to push a loaded foot outward over rubber: from some phases of a tripod walk two feet
hold it up like a trestle, and let go at once (docs/stops.md)."""


@pytest.mark.parametrize(
    ("world", "stance"),
    [pair for pair in product(WORLDS, STANCES) if pair[1] in HARDEST or pair[0] in ("as assumed", WEAK)],
)
def test_a_landing_from_any_phase_is_gentle(world: str, stance: str) -> None:
    each = (looked_at(deepcopy(begin), landed(angles)) for begin, angles in moments(stance, WORLDS[world]))
    found = reduce(Fall.worse, each)
    assert found.speed_m_s < (STUCK_M_S if (world, stance) in STUCK else MOST_SPEED_M_S)
    assert found.tilt_deg < MOST_TILT_DEG
    assert found.drop_m > 0.08, "it stood"


@pytest.mark.parametrize("gait", GAITS)
def test_a_stop_in_any_phase_of_a_stride_lets_it_sink_and_never_topple(gait: str) -> None:
    """All servos slack, as after an emergency stop, at six times within a stride: faster down than by a landing."""
    for begin, _ in moments(gait, Assumed()):
        world = deepcopy(begin)
        fallen = looked_at(world, [(0.0, SLACK)])
        assert fallen.speed_m_s > MOST_SPEED_M_S
        assert fallen.tilt_deg < physics.FALLEN_DEG
        physics.run(world, physics.SINKS_S - AFTER_S)
        assert world.body().position_m[2] < physics.SUNK_M
