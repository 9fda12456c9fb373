"""Joint names, radians and trajectories, as controllers of ROS 2 send them, to the degrees of whole legs. Pure.

A trajectory is followed in time, which is an argument, as ros2_control's joint_trajectory_controller does: from where
the robot is to the first point that is still to come, then from point to point, in straight lines, or in curves where
both points have velocities. What it takes stays within each servo's range and speed between its points, too: nothing is
clamped on the way.
"""

import math
import re
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise, product
from typing import Any, Final, NamedTuple, Self

from gateway.geometry import MAX_SPEED_DEG_S, Geometry, joint_name
from schemas.robot import JOINTS, LEGS, MAX_DEG, SERVO_IDS

Degrees = tuple[float, float, float]
"""The degrees of a leg's joints 1, 2 and 3."""
_PATTERN: Final = re.compile(r"(\{leg\}|\{joint\}|[\w./-]){1,64}", re.ASCII)


class JointsError(ValueError):
    """A controller requests something impossible; one sentence."""


class NamesError(JointsError):
    """Its joints are not those of this robot, or not of whole legs."""


class JointNames:
    """The joints' names in ROS messages, from a pattern: `leg{leg}_J{joint}` names the Elkapod's leg1_J1 to leg6_J3."""

    def __init__(self, pattern: str = "joint_{leg}{joint}") -> None:
        """The default names are the URDF's. Raises JointsError if the pattern does not give each joint its own name."""
        if not _PATTERN.fullmatch(pattern):
            raise JointsError(f"{pattern[:80]!r} is no pattern of joint names, such as leg{{leg}}_J{{joint}}")
        self._names = {
            servo_id: pattern.replace("{leg}", str(servo_id // 10)).replace("{joint}", str(servo_id % 10))
            for servo_id in SERVO_IDS
        }
        self._servos = {name: servo_id for servo_id, name in self._names.items()}
        if len(self._servos) < len(SERVO_IDS):
            raise JointsError(f"{pattern!r} gives two joints one name: it needs {{leg}} and {{joint}}")

    def of(self, servo_id: int) -> str:
        """Return the name of a servo's joint."""
        return self._names[servo_id]

    def servos(self, names: Sequence[str]) -> tuple[int, ...]:
        """Return the joints' servos in order. Raises NamesError if a name is unknown or a leg is incomplete."""
        if not names:
            raise NamesError("it names no joint")
        for name in names:
            if name not in self._servos:
                first, *_, last = self._servos
                raise NamesError(f"there is no joint {name[:64]!r}; they are {first} to {last}, leg and then joint")
            if names.count(name) > 1:
                raise NamesError(f"it names {name} twice")
        servos = tuple(self._servos[name] for name in names)
        for servo_id, joint in product(servos, JOINTS):
            leg = servo_id // 10
            if 10 * leg + joint not in servos:
                raise NamesError(f"of leg {leg} it lacks {self.of(10 * leg + joint)}; a leg is commanded as a whole")
        return servos


def of_joints(
    what: str, servos: Sequence[int], values: Sequence[float], most: float = math.inf, unit: str = ""
) -> dict[int, float]:
    """Return servo → value; `what` names a value in errors. Raises JointsError if one is missing or beyond `most`."""
    if len(values) != len(servos):
        raise JointsError(f"there must be one {what} for each of {len(servos)} joints, not {len(values)}")
    found = dict(zip(servos, values, strict=True))
    for servo_id, value in found.items():
        if not math.isfinite(value):
            raise JointsError(f"the {what} of {joint_name(servo_id)} is {value}")
        if abs(value) > most * _SPARE:
            raise JointsError(
                f"the {what} of {joint_name(servo_id)} is {value:.4g} {unit}, more than {most:.4g} (are these degrees?)"
            )
    return found


def check_reach(geometry: Geometry, at_rad: Mapping[int, float]) -> None:
    """Raise JointsError if a servo would leave 0 to 180°."""
    for servo_id, position in at_rad.items():
        angle_deg = geometry.servos[servo_id].servo_deg(position)
        if not 0.0 <= angle_deg <= MAX_DEG:
            raise JointsError(
                f"{joint_name(servo_id)} at {position:.4g} rad is {angle_deg:.4g}° of its servo, which has 0 to 180°"
            )


def legs_deg(geometry: Geometry, at_rad: Mapping[int, float]) -> dict[int, Degrees]:
    """Return leg → degrees of its servos, clamped to 0 to 180."""
    deg = {name: min(max(geometry.servos[name].servo_deg(at), 0.0), MAX_DEG) for name, at in at_rad.items()}
    return {leg: (deg[10 * leg + 1], deg[10 * leg + 2], deg[10 * leg + 3]) for leg in LEGS if 10 * leg + 1 in deg}


# ---- trajectories

MAX_POINTS: Final = 2000
"""Forty seconds at 50 Hz; a longer plan is better sent in pieces."""
MAX_S: Final = 60.0
"""Long enough for a robot that people stand next to, and short enough to notice a plan in milliseconds."""

MAX_RAD_S: Final = math.radians(MAX_SPEED_DEG_S)
SETPOINT_S: Final = 0.02
"""Period at 50 Hz. A change within one setpoint has no speed of its own."""
MAX_RAD_S2: Final = MAX_RAD_S / SETPOINT_S
"""Full speed from rest within one setpoint. Accelerations are checked, but do not bend the way."""
_SPARE: Final = 1.001
"""Part of the speed that rounding to nanoseconds and floats may add."""
_END: Final = 1e-6
"""Part of a way. Nearer to an end than this it is at a point, which is checked itself."""


class OverError(JointsError):
    """The trajectory's end is past, by its stamp."""


class Waypoint(NamedTuple):
    """A pose of the joints, and its time in seconds from the trajectory's start."""

    at_s: float
    positions_rad: Mapping[int, float]
    velocities_rad_s: Mapping[int, float] | None = None


class Trajectory:
    """One trajectory; `at` returns where the joints are to be."""

    def __init__(self, points: tuple[Waypoint, ...], begins_s: float) -> None:
        """`begins_s`: the time from which its points count, by the clock of `at`."""
        self._points = points
        self.begins_s = begins_s
        self._from = points[0]

    @classmethod
    def read(cls, message: Any, names: JointNames, geometry: Geometry, now_s: float, since_1970_ns: int) -> Self:
        """Read a JointTrajectory. `now_s` is now by the clock of `at`, `since_1970_ns` by that of stamps.

        Raises JointsError.
        """
        servos = names.servos(message.joint_names)
        if not message.points:
            raise JointsError("it has no points")
        if len(message.points) > MAX_POINTS:
            raise JointsError(f"it has {len(message.points)} points, more than {MAX_POINTS}")
        points: list[Waypoint] = []
        for number, point in enumerate(message.points, start=1):
            try:
                at_s = seconds(point.time_from_start)
                if points and at_s <= points[-1].at_s:
                    raise JointsError(f"its time {at_s:g} s is not later than that of the point before it")
                if not 0 <= at_s <= MAX_S:
                    raise JointsError(f"its time {at_s:g} s is not between 0 and {MAX_S:g} s")
                at_rad = of_joints("position", servos, point.positions)
                check_reach(geometry, at_rad)
                velocities = None
                if point.velocities:  # for all joints or for none
                    velocities = of_joints("velocity", servos, point.velocities, MAX_RAD_S, "rad/s")
                if point.accelerations:
                    of_joints("acceleration", servos, point.accelerations, MAX_RAD_S2, "rad/s²")
                points.append(Waypoint(at_s, at_rad, velocities))
                for before, after in pairwise(points[-2:]):
                    for servo_id in servos:
                        way = _JointCubic.of(before, after, servo_id)
                        _check_speed(servo_id, way.fastest() / (after.at_s - before.at_s), "on the way there")
                        for part in way.turns():
                            check_reach(geometry, {servo_id: way.at(part)})
            except JointsError as error:
                raise JointsError(f"point {number}: {error}") from error
        return cls(tuple(points), now_s - _elapsed_s(message, points[-1].at_s, since_1970_ns))

    @property
    def ends_s(self) -> float:
        """When the last point is due, by the clock of `at`."""
        return self.begins_s + self._points[-1].at_s

    def elapsed_s(self, now_s: float) -> float:
        """Return the seconds since the trajectory's start."""
        return now_s - self.begins_s

    def begin(self, present_rad: Mapping[int, float], now_s: float) -> None:
        """Start from the present angles. A joint that is not in `present_rad` begins at the next point.

        Raises JointsError if a servo would have to turn too fast to the next point.
        """
        after = self._points[self._next(now_s)]
        at_rad = {servo_id: present_rad.get(servo_id, at) for servo_id, at in after.positions_rad.items()}
        before = Waypoint(self.elapsed_s(now_s), at_rad)
        length_s = max(after.at_s - before.at_s, SETPOINT_S)
        for servo_id, at in at_rad.items():
            _check_speed(servo_id, (after.positions_rad[servo_id] - at) / length_s, "from where it is")
        self._from = before

    def at(self, now_s: float) -> dict[int, float]:
        """Return servo → radians at `now_s`. Call `begin` first."""
        index = self._next(now_s)
        before, after = self._from, self._points[index]
        if index > 0 and self._points[index - 1].at_s > before.at_s:
            before = self._points[index - 1]
        length_s = after.at_s - before.at_s
        part = (self.elapsed_s(now_s) - before.at_s) / length_s if length_s > 0 else 1.0
        part = min(max(part, 0.0), 1.0)
        return {servo_id: _JointCubic.of(before, after, servo_id).at(part) for servo_id in after.positions_rad}

    def _next(self, now_s: float) -> int:
        """Return the first point that is still to come, or the last."""
        index = bisect_right(self._points, self.elapsed_s(now_s), key=lambda point: point.at_s)
        return min(index, len(self._points) - 1)


class _JointCubic(NamedTuple):
    """One joint's way between two points: a cubic of `part`, which goes from 0 to 1."""

    begin: float
    first: float
    square: float
    cube: float

    @classmethod
    def of(cls, before: Waypoint, after: Waypoint, servo_id: int) -> Self:
        """A cubic Hermite spline, or a line."""
        begin = before.positions_rad[servo_id]
        change_rad = after.positions_rad[servo_id] - begin
        if before.velocities_rad_s is None or after.velocities_rad_s is None:
            return cls(begin, change_rad, 0.0, 0.0)
        length_s = after.at_s - before.at_s
        leaves, arrives = before.velocities_rad_s[servo_id] * length_s, after.velocities_rad_s[servo_id] * length_s
        return cls(begin, leaves, 3 * change_rad - 2 * leaves - arrives, leaves + arrives - 2 * change_rad)

    def at(self, part: float) -> float:
        return self.begin + part * (self.first + part * (self.square + part * self.cube))

    def speed(self, part: float) -> float:
        """Speed in radians for the whole way."""
        return self.first + part * (2 * self.square + part * 3 * self.cube)

    def turns(self) -> Iterator[float]:
        """Yield the parts between the ends at which the way reverses: where the speed, a p² + 2 b p + c, is zero."""
        a, b, c = 3 * self.cube, self.square, self.first
        if (under := b * b - a * c) >= 0:
            q = -(b + math.copysign(math.sqrt(under), b))  # no difference of numbers that are nearly equal
            yield from (over / below for over, below in ((q, a), (c, q)) if below and _END < over / below < 1 - _END)

    def fastest(self) -> float:
        """Return the highest speed on the way, with its sign: at an end, or where the acceleration changes its sign."""
        parts = [0.0, 1.0]
        if self.cube and 0 < (middle := -self.square / (3 * self.cube)) < 1:
            parts.append(middle)
        return max((self.speed(part) for part in parts), key=abs)


def _check_speed(servo_id: int, speed_rad_s: float, where: str) -> None:
    if abs(speed_rad_s) > MAX_RAD_S * _SPARE:
        turns = f"{joint_name(servo_id)} would turn at {math.degrees(speed_rad_s):.4g}°/s {where}"
        raise JointsError(f"{turns}; at most {MAX_SPEED_DEG_S:g}°/s")


def _elapsed_s(message: Any, length_s: float, since_1970_ns: int) -> float:
    """Seconds since its start: by its stamp, else 0. Raises JointsError."""
    begins_ns = stamp_ns(message.header)
    if begins_ns == 0:
        return 0.0
    elapsed_s = (since_1970_ns - begins_ns) / 1e9
    if elapsed_s >= length_s:
        raise OverError(f"it was over {elapsed_s - length_s:.1f} s ago by its stamp (does its clock agree with ours?)")
    if elapsed_s < -MAX_S:
        raise JointsError(f"it begins in {-elapsed_s:.1f} s by its stamp; at most {MAX_S:g} s ahead are taken")
    return elapsed_s


def seconds(duration: Any) -> float:
    """Return a Duration in seconds."""
    return float(duration.sec + duration.nanosec / 1e9)


def stamp_ns(header: Any) -> int:
    """Return a Header's stamp in ns since 1970; 0: no stamp."""
    return int(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec)
