"""The robot for its rides: geometry, range and speed of each servo, and where its feet can be. Pure."""

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Final, NamedTuple

from gateway.errors import WalkError
from gateway.geometry import MAX_SPEED_DEG_S, Geometry
from gateway.geometry.kinematics import Vector
from gateway.geometry.urdf import BODY_HEIGHT_M
from gateway.model.frames import servo_ids_of
from gateway.people.walking.inverse import Angles, LegPositions, Limb
from gateway.people.walking.motion import BodyPose
from schemas.calibration import Calibration
from schemas.config import LimitsReport, ServoLimitsReport
from schemas.gateway_state import GatewayState
from schemas.robot import JOINTS, LEGS, MAX_DEG, SERVO_IDS


class Range(NamedTuple):
    """The range of one servo in degrees, as commanded, and its speed."""

    min_deg: float = 0.0
    max_deg: float = MAX_DEG
    max_speed_deg_s: float = math.inf

    def within(self, other: "Range") -> "Range":
        """Return the range that both allow."""
        return Range(
            max(self.min_deg, other.min_deg),
            min(self.max_deg, other.max_deg),
            min(self.max_speed_deg_s, other.max_speed_deg_s),
        )


class Stance(NamedTuple):
    """A body's pose, where its feet rest below it, and how far each may go from there."""

    body: BodyPose
    feet: Mapping[int, Vector]
    """By leg, where its foot rests, in the ground frame."""
    radius_m: float
    """The radius of the disc around each resting place. A foot stays in its disc, on the ground and lifted."""
    why: str = ""
    """The limit that keeps the discs from being larger."""

    def check_walks(self) -> None:
        """Raise WalkError if the feet have no room for a stride."""
        if self.radius_m < LEAST_RADIUS_M:
            raise WalkError(f"its limits leave it no stride {_pose(self.body)}: {self.why}")


Pose = Mapping[int, Angles]
"""By leg, the commanded angles in degrees."""

FEED_S: Final = 1.5
"""One servo that is fed alone and judged (0.3 s), and 18 at the board's slowest pace of 54 ms each (docs/stops.md)."""
LIFT_M: Final = 0.035
STRIDE_RADIUS_M: Final = 0.055
"""How far a foot goes from where it rests; with longer strides the legs of the Elkapod touch."""
LEAST_RADIUS_M: Final = 0.008
"""The smallest disc that leaves room for a stride."""
WIDE_RAD: Final = math.radians(12.0)
"""A body that leans this far needs its feet further out: legs right below it would have no stride."""
_WIDE_RADIUS_M: Final = 0.030
_SPARE_DEG: Final = 0.5
"""Kept free of each joint's limits within the discs."""
_REACH_STEP_M: Final = 0.01
_HEIGHT: Final = 0.7
"""The usual height, as a part of the height at which the femur is level and the tibia upright."""
_DIRECTIONS: Final = tuple((math.cos(angle), math.sin(angle)) for angle in (math.tau * k / 12 for k in range(12)))
_HALVINGS: Final = 7
_CLEARANCE_M: Final = 0.003


def largest(fits: Callable[[float], bool]) -> float:
    """Return the largest part from 0 to 1 that fits; all smaller parts must fit, too."""
    if fits(1.0):
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


class Robot:
    """Computes where the robot's feet can be, and by which angles."""

    def __init__(
        self,
        geometry: Geometry,
        ranges: Mapping[int, Range] = MappingProxyType({}),
        *,
        starts_whole: bool = False,
        fed_singly: bool = False,
    ) -> None:
        """`ranges`: of servos whose range is smaller than 0 to 180, or whose speed is limited.

        `starts_whole`: the controller starts and stops only all six legs. `fed_singly`: a power board feeds the servos
        one after the other, each from its start. Raises WalkError if limits leave a servo no angle.
        """
        self.geometry = geometry
        self.starts_whole = starts_whole
        self.limp_s = FEED_S if fed_singly else 0.0
        """For this time (seconds) after the last start a servo may not be fed yet."""
        self._limbs = {leg: Limb(geometry, leg) for leg in LEGS}
        self.ranges = {servo_id: self._range(servo_id, ranges) for servo_id in SERVO_IDS}
        self.middle_m = geometry.middle_m
        self.lying_m = BODY_HEIGHT_M / 2 + _CLEARANCE_M - self.middle_m[2]
        """The height at which the body lies on the ground."""
        _, coxa_m, femur_m, tibia_m = (math.hypot(*part.origin_xyz_m) for part in geometry.chain)
        steps = int((femur_m + tibia_m) / _REACH_STEP_M)
        self._reaches_m = tuple(coxa_m + femur_m + _REACH_STEP_M * step for step in range(-2, steps))
        """Distances (m) from its mount at which a foot may rest, the nearest (least force) below the knee."""
        shoulder_m = self.middle_m[2] + geometry.joints[0].origin_xyz_m[2]
        self.usual_m = round(max(_HEIGHT * (tibia_m - shoulder_m), self.lying_m), 3)
        """The height at which the robot stands by default."""
        self.stance = lru_cache(maxsize=16)(self._stance)
        self.widened = lru_cache(maxsize=16)(self._widened)

    def angles_deg(self, leg: int, foot_m: Vector, spare_deg: float = 0.0) -> Angles:
        """Return the servos' angles for this foot position (body's frame). Raises WalkError with the limit."""
        (first, second, third), (a, b, c) = servo_ids_of(leg), self._limbs[leg].inverse(foot_m)
        find = self._angle_deg
        return find(first, a, spare_deg), find(second, b, spare_deg), find(third, c, spare_deg)

    def positions(self, leg: int, angles_deg: Angles) -> LegPositions:
        """Return where a leg's joints and foot are at these angles (degrees), in the body's frame."""
        (first, second, third), (a, b, c) = servo_ids_of(leg), angles_deg
        find = self.geometry.joint_rad
        return self._limbs[leg].forward((find(first, a), find(second, b), find(third, c)))

    def foot_m(self, leg: int, angles_deg: Angles) -> Vector:
        return self.positions(leg, angles_deg).foot_m

    def _stance(self, body: BodyPose, *, walks: bool = True) -> Stance:
        """Return the stance at this pose with the largest discs. Raises WalkError if there is none.

        `walks`: the feet need room for a stride; else they only stand.
        """
        if not all(map(math.isfinite, body)):
            raise WalkError("a height and a leaning are finite numbers")
        if body.height_m < self.lying_m:
            raise WalkError(f"it cannot stand {_pose(body)}: it lies on the ground at {self.lying_m:.3f} m")
        wanted_m = STRIDE_RADIUS_M if walks else LEAST_RADIUS_M
        fits: list[dict[int, Vector]] = []
        why = ""
        for reach_m in self._reaches_m:
            feet = self._below(reach_m)
            if not (error := self._why_not(body, feet, 0.0)):
                fits.append(feet)
                error = self._why_not(body, feet, wanted_m)
            if not error:
                return Stance(body, MappingProxyType(feet), wanted_m)
            why = why or error  # the first is of the place that needs the least force
        if not fits:
            raise WalkError(f"it cannot stand {_pose(body)}: {why}")

        def radius_m(feet: Mapping[int, Vector]) -> float:
            return wanted_m * largest(lambda part: not self._why_not(body, feet, wanted_m * part))

        widest = max(fits, key=radius_m)
        return Stance(body, MappingProxyType(widest), radius_m(widest), why)

    def _widened(self, body: BodyPose) -> Mapping[int, Vector]:
        """Return places where feet keep `_WIDE_RADIUS_M` in each lean by WIDE_RAD; if there are none, the stance's."""
        height_m, roll_rad, pitch_rad = body
        leaning = [
            BodyPose(height_m, roll_rad + WIDE_RAD * across, pitch_rad + WIDE_RAD * along)
            for across, along in _DIRECTIONS[:: len(_DIRECTIONS) // 4]
        ]
        for reach_m in self._reaches_m:
            feet = self._below(reach_m)
            if not any(self._why_not(each, feet, _WIDE_RADIUS_M) for each in leaning):
                return MappingProxyType(feet)
        return self.stance(body).feet

    def _below(self, reach_m: float) -> dict[int, Vector]:
        mounts = self.geometry.leg_mounts
        return {
            leg: (
                mounts[leg].xyz_m[0] + reach_m * math.cos(mounts[leg].yaw_rad),
                mounts[leg].xyz_m[1] + reach_m * math.sin(mounts[leg].yaw_rad),
                0.0,
            )
            for leg in LEGS
        }

    def _why_not(self, body: BodyPose, feet: Mapping[int, Vector], radius_m: float) -> str:
        """Return why feet do not reach all of the discs with this radius; "" if they do.

        A sentence: an error would hold the frames of all callers, and so a walk that its program drops.
        """
        try:
            for leg, (x, y, _) in feet.items():
                for across, along in _DIRECTIONS if radius_m else _DIRECTIONS[:1]:
                    for up_m in (0.0, LIFT_M):
                        point = x + radius_m * across, y + radius_m * along, up_m
                        self.angles_deg(leg, body.seen(point), _SPARE_DEG)
        except WalkError as error:
            return str(error)
        return ""

    def _range(self, servo_id: int, ranges: Mapping[int, Range]) -> Range:
        """Return the range that both the servo and the joint allow."""
        servo = self.geometry.servos[servo_id]
        ends = [servo.servo_deg(limit) for limit in self.geometry.joints[servo_id % 10 - 1].limits_rad]
        usual = Range(max_speed_deg_s=MAX_SPEED_DEG_S)
        found = Range().within(Range(min(ends), max(ends))).within(ranges.get(servo_id, usual))
        if found.min_deg > found.max_deg:
            raise WalkError(f"servo {servo_id}: its limits and its joint's leave no angle")
        return found

    def _angle_deg(self, servo_id: int, joint_rad: float, spare_deg: float) -> float:
        angle_deg = self.geometry.servos[servo_id].servo_deg(joint_rad)
        allowed = self.ranges[servo_id]
        for candidate_deg in (angle_deg, angle_deg - 360.0, angle_deg + 360.0):
            if allowed.min_deg + spare_deg <= candidate_deg <= allowed.max_deg - spare_deg:
                return candidate_deg
        raise WalkError(
            f"servo {servo_id} would stand at {angle_deg:.1f} degrees, and may go from {allowed.min_deg:g} to "
            f"{allowed.max_deg:g}"
        )


def _pose(body: BodyPose) -> str:
    leaning = f", leaning {body.roll_rad:g} and {body.pitch_rad:g} rad" if body.roll_rad or body.pitch_rad else ""
    return f"{body.height_m:g} m high{leaning}"


# ---- what a gateway allows: its settings, its calibration, and what the wire can carry


def ranges(limits: LimitsReport, calibration: Calibration | None) -> dict[int, Range]:
    """Return each servo's range, in the degrees of commands. Without a limit the speed is a usual servo's."""
    return {servo_id: _range(str(servo_id), limits, calibration) for servo_id in SERVO_IDS}


def check_mirrored_once(geometry: Geometry, calibration: Calibration | None) -> None:
    """Raise WalkError if both invert the same joint of some legs, which would then move the wrong way.

    A wrong zero cannot be noticed: only the file states it.
    """
    if calibration is None:
        return
    for joint in JOINTS:
        names = [str(10 * leg + joint) for leg in LEGS]
        inverted = [name for name in names if name in calibration.servos and calibration.servos[name].inverted]
        directions = {name: geometry.servos[int(name)].direction for name in names}
        ways = {directions[name] for name in inverted}, {directions[name] for name in names if name not in inverted}
        if all(len(way) == 1 for way in ways) and ways[0] != ways[1]:
            raise WalkError(
                f"servos {', '.join(inverted)} are turned round by the calibration, and by the geometry "
                f"{geometry.name} once more; --geometry names a file that counts as commands do, such as "
                "examples/elkapod/geometry.json"
            )


def running_deg(state: GatewayState) -> dict[int, Angles]:
    """Return the legs with all servos running, and their commanded angles in degrees."""
    found: dict[int, Angles] = {}
    for leg in state.legs:
        angles = [servo.angle_deg for servo in leg.servos if servo.running and servo.angle_deg is not None]
        if len(angles) == len(leg.servos):
            found[leg.leg] = angles[0], angles[1], angles[2]
    return found


def _range(name: str, limits: LimitsReport, calibration: Calibration | None) -> Range:
    setting = limits.servos.get(name, ServoLimitsReport())
    found = Range(setting.min_deg, setting.max_deg, setting.max_speed_deg_s or MAX_SPEED_DEG_S)
    if calibration is None or (servo := calibration.servos.get(name)) is None:
        return found
    lowest_deg = servo.trim_deg if servo.inverted else -servo.trim_deg
    on_the_wire = Range(lowest_deg, lowest_deg + MAX_DEG)
    return found.within(Range(servo.min_deg, servo.max_deg)).within(on_the_wire)
