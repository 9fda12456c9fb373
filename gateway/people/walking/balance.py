"""What the sensors report about the ground: how the body leans, which feet carry, whether it has fallen. Pure.

A foot's sensor counts once it has reported contact and no contact. A stuck sensor counts as unknown, and its foot walks
as without sensors. Forces have the robot's own unit, so they are compared with its weight.
"""

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

from gateway.errors import WalkError
from gateway.people.walking.motion import BodyPose
from schemas.robot import LEGS
from schemas.telemetry import Telemetry

TERRAINS: Final = ("level", "adapt")
"""`level`: the walk assumes a level floor. `adapt`: the floor is as the sensors report it, if there are some."""
FALLEN_DEG: Final = 45.0
"""A body that leans further has fallen."""
_FRESH_S: Final = 0.3
"""An older measurement does not count. By default ten a second are published."""
_FALLEN_S: Final = 0.2
_LIFTED_S: Final = 0.3
"""Longer than a walking robot's feet are ever unloaded together."""
_LIFTED: Final = 0.2
_CARRIES: Final = 0.05
"""The part of the weight above which a foot touches the ground."""
_WEIGHS_S: Final = 1.0
"""The weight is the mean of the forces over this time, so that a hard step does not count as weight."""
_LEVELS_1_S: Final = 1.5
"""The part of the lean corrected per second: slow against a stride, so that swinging feet do not excite it."""
_LEVELS_RAD_S: Final = 0.2
LEANS_RAD: Final = math.radians(15.0)
"""The most that the body leans against its feet to be level."""
LEANS_MORE_RAD_S: Final = math.radians(1.5)
"""How fast that limit grows again after legs had no room for a stride: feet that step find more room."""
_RISES_1_S: Final = 1.0
_RISES_M_S: Final = 0.03
EARLY_M: Final = 0.010
"""Servos give way under load. A foot that touches below this height goes on to the expected ground."""
LATE_S: Final = 0.12
"""The longest wait of a foot for its contact before it goes further down: sensors may be 0.1 s late."""
WAIT_FORGOTTEN: Final = 0.8
"""The part of that wait which is kept after each contact that was reported at once."""
CERTAIN_S: Final = 0.07
"""Uneven ground alone delays contacts by this much: sensors with a smaller lateness count as punctual."""
_LEARNS_S: Final = (0.02, 0.005)
"""The step of the lateness (seconds) for each of the first contacts, and for each later contact."""
_FIRST: Final = 12
SINKS_M_S: Final = 0.10
DEEPEST_M: Final = 0.030
"""How far below the expected ground a foot goes at most."""


def terrain_named(name: str) -> str:
    """Return `name`. Raises WalkError for an unknown terrain."""
    if name not in TERRAINS:
        raise WalkError(f"there is no terrain {name!r}; there are {', '.join(TERRAINS)}")
    return name


class ReceivedTelemetry:
    """Holds the newest telemetry, which another thread receives."""

    def __init__(self) -> None:
        self._newest: tuple[Telemetry | None, float] = (None, 0.0)
        """The telemetry and when it was received, as one object for both threads."""

    def take(self, telemetry: Telemetry, now_s: float) -> None:
        self._newest = telemetry, now_s

    def fresh(self, now_s: float) -> Telemetry | None:
        """Return the newest telemetry; None if it is older than 0.3 s."""
        telemetry, came_s = self._newest
        return telemetry if telemetry is not None and now_s - came_s + telemetry.age_ms / 1000 < _FRESH_S else None


class Felt(NamedTuple):
    """The sensors' report now. Without sensors all is unknown, and the robot walks as on level ground."""

    roll_rad: float | None = None
    pitch_rad: float | None = None
    tilt_deg: float | None = None
    feet: Mapping[int, bool] = {}
    """By leg, whether its foot touches the ground. Only feet whose sensors count."""
    carrying: tuple[bool, ...] | None = None
    """By leg (1 to 6), whether it carries, as measured; None: not measured."""
    fault: str = ""
    """Why nothing may move now, as a sentence; "" if legs may move."""


NOTHING: Final = Felt()


class Senses:
    """Judges telemetry, tick by tick."""

    def __init__(self) -> None:
        self._weight = 0.0
        self._seen: set[tuple[int, bool]] = set()
        """What the sensor of each leg has reported: no contact, contact."""
        self._tilted_s = self._lifted_s = 0.0

    def take(self, telemetry: Telemetry | None, seconds: float, *, stands: bool = True) -> Felt:
        """Return what this telemetry (None: none is fresh) shows. `stands`: the belly does not carry the robot."""
        if telemetry is None:
            self._tilted_s = self._lifted_s = 0.0
            return NOTHING
        tilt_deg, forces, carrying = telemetry.tilt_deg, telemetry.feet, None
        if forces is not None and all(map(math.isfinite, forces)):
            total = sum(max(0.0, force) for force in forces)
            lifted = stands and total < _LIFTED * self._weight
            self._lifted_s = self._lifted_s + seconds if lifted else 0.0
            if stands and not lifted:
                self._weight += (total - self._weight) * (min(1.0, seconds / _WEIGHS_S) if self._weight else 1.0)
            carrying = tuple(force > _CARRIES * self._weight for force in forces)
        self._tilted_s = self._tilted_s + seconds if (tilt_deg or 0.0) > FALLEN_DEG else 0.0
        reported = [*zip(LEGS, carrying or (), strict=False)]
        self._seen.update(reported)
        feet = {leg: carries for leg, carries in reported if (leg, not carries) in self._seen}
        fault = ""
        if self._tilted_s > _FALLEN_S:
            fault = f"the body leans by {tilt_deg:.0f} degrees: it has fallen"
        elif self._lifted_s > _LIFTED_S:
            fault = "no foot carries: somebody has lifted it"
        return Felt(*_lean(telemetry), tilt_deg, feet, carrying, fault)


class Lateness(NamedTuple):
    """How late the sensors of the feet are: the median over the contacts.

    Higher ground than expected is as frequent as lower ground, since the walk's own ground follows the mean.
    """

    median_s: float = 0.0
    contacts: int = 0

    def after(self, late_s: float) -> "Lateness":
        """Return the lateness after a further contact, `late_s` after its foot arrived (below 0: before)."""
        step_s = _LEARNS_S[self.contacts >= _FIRST]
        median_s = self.median_s + math.copysign(step_s, late_s - self.median_s)
        return Lateness(max(0.0, min(LATE_S, median_s)), self.contacts + 1)


UNKNOWN_LATENESS: Final = Lateness()


def levelled(body: BodyPose, wanted: BodyPose, felt: Felt, most_rad: float, seconds: float) -> BodyPose:
    """Return the body's next pose, towards the wanted lean against the world; `most_rad` and a rate limit it.

    Without an orientation the pose stays.
    """
    if felt.roll_rad is None or felt.pitch_rad is None:
        return body

    def towards(now_rad: float, off_rad: float, asked_rad: float) -> float:
        most = _LEVELS_RAD_S * seconds
        aim_rad = now_rad - _LEVELS_1_S * off_rad * seconds
        aim_rad = max(asked_rad - most_rad, min(asked_rad + most_rad, aim_rad))
        return now_rad + max(-most, min(most, aim_rad - now_rad))

    return BodyPose(
        body.height_m,
        towards(body.roll_rad, felt.roll_rad - wanted.roll_rad, wanted.roll_rad),
        towards(body.pitch_rad, felt.pitch_rad - wanted.pitch_rad, wanted.pitch_rad),
    )


def lowered_by(heights_m: list[float], seconds: float) -> float:
    """Return by how much (m) the ground frame rises to the mean of the standing feet; the body climbs with them."""
    mean_m = sum(heights_m) / len(heights_m) if heights_m else 0.0
    most = _RISES_M_S * seconds
    return max(-most, min(most, _RISES_1_S * mean_m * seconds))


def _lean(telemetry: Telemetry) -> tuple[float | None, float | None]:
    """Return roll and pitch (radians, as in `BodyPose`); None if the orientation is invalid, or the body has fallen."""
    if telemetry.imu is None or telemetry.tilt_deg is None or telemetry.tilt_deg > FALLEN_DEG:
        return None, None
    w, x, y, z = telemetry.imu.orientation_wxyz
    ahead, aside, up = 2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z  # not normalised
    return math.atan2(aside, up), math.atan2(-ahead, math.hypot(aside, up))
