"""A JointTrajectory, followed in time. Pure: time is an argument.

It is followed as ros2_control's joint_trajectory_controller does: from where the robot is to the first point that is
still to come, then from point to point, in straight lines, or in curves where both points have velocities.
"""

from bisect import bisect_right
from collections.abc import Mapping
from typing import Final, NamedTuple, Self

from gateway.geometry import Geometry
from gateway.people.ros2.joints import JointsError, check_reach, positions, servos_of
from gateway.people.ros2.messages import Duration, JointTrajectory

MAX_POINTS: Final = 2000
"""Forty seconds at 50 Hz; a longer plan is better sent in pieces."""
MAX_S: Final = 60.0
"""Nobody plans further ahead beside a robot that people stand at; and a plan in milliseconds is noticed."""


class Point(NamedTuple):
    """Where the joints are to be, and when, in seconds from the trajectory's start."""

    at_s: float
    positions_rad: Mapping[int, float]
    velocities_rad_s: Mapping[int, float] | None = None


class Trajectory:
    """One trajectory; `at` returns where the joints are to be."""

    def __init__(self, points: tuple[Point, ...], begins_s: float) -> None:
        """`begins_s`: the time from which its points count, by the clock of `at`."""
        self._points = points
        self._times_s = [point.at_s for point in points]
        self._begins_s = begins_s
        self._from = points[0]

    @classmethod
    def read(cls, message: JointTrajectory, geometry: Geometry, now_s: float, since_1970_ns: int) -> Self:
        """`now_s` is now by the clock of `at`, `since_1970_ns` by that of stamps. Raises JointsError."""
        servos = servos_of(message.joint_names)
        if not message.points:
            raise JointsError("it has no points")
        if len(message.points) > MAX_POINTS:
            raise JointsError(f"it has {len(message.points)} points, more than {MAX_POINTS}")
        points: list[Point] = []
        for number, point in enumerate(message.points, start=1):
            try:
                at_s = _seconds(point.time_from_start)
                if points and at_s <= points[-1].at_s:
                    raise JointsError(f"its time {at_s:g} s is not later than that of the point before it")
                if not 0 <= at_s <= MAX_S:
                    raise JointsError(f"its time {at_s:g} s is not between 0 and {MAX_S:g} s")
                at_rad = positions(servos, point.positions)
                check_reach(geometry, at_rad)
                velocities = positions(servos, point.velocities) if point.velocities else None
            except JointsError as error:
                raise JointsError(f"point {number}: {error}") from error
            points.append(Point(at_s, at_rad, velocities))
        return cls(tuple(points), now_s - _elapsed_s(message, points[-1].at_s, since_1970_ns))

    @property
    def ends_s(self) -> float:
        """When its last point is reached."""
        return self._begins_s + self._points[-1].at_s

    def begin(self, present_rad: Mapping[int, float], now_s: float) -> None:
        """Go on from where the joints are now. One that is not in `present_rad` begins at the next point."""
        next_rad = self._points[self._next(now_s)].positions_rad
        at_rad = {servo_id: present_rad.get(servo_id, next_rad[servo_id]) for servo_id in next_rad}
        self._from = Point(now_s - self._begins_s, at_rad)

    def at(self, now_s: float) -> dict[int, float]:
        """Servo → radians, after `begin`."""
        index = self._next(now_s)
        before, after = self._from, self._points[index]
        if index > 0 and self._points[index - 1].at_s > before.at_s:
            before = self._points[index - 1]
        length_s = after.at_s - before.at_s
        part = (now_s - self._begins_s - before.at_s) / length_s if length_s > 0 else 1.0
        part = min(max(part, 0.0), 1.0)
        return {servo_id: _between(before, after, servo_id, part, length_s) for servo_id in after.positions_rad}

    def _next(self, now_s: float) -> int:
        """The first point that is still to come, or the last."""
        return min(bisect_right(self._times_s, now_s - self._begins_s), len(self._points) - 1)


def _between(before: Point, after: Point, servo_id: int, part: float, length_s: float) -> float:
    begin, end = before.positions_rad[servo_id], after.positions_rad[servo_id]
    if before.velocities_rad_s is None or after.velocities_rad_s is None:
        return begin + (end - begin) * part
    leaves, arrives = before.velocities_rad_s[servo_id] * length_s, after.velocities_rad_s[servo_id] * length_s
    square, cube = part * part, part * part * part  # a cubic Hermite spline
    return (
        (2 * cube - 3 * square + 1) * begin
        + (cube - 2 * square + part) * leaves
        + (3 * square - 2 * cube) * end
        + (cube - square) * arrives
    )


def _elapsed_s(message: JointTrajectory, length_s: float, since_1970_ns: int) -> float:
    """How long ago it began: it has a stamp, or begins now. Raises JointsError."""
    begins = message.header.stamp
    if begins.sec == 0 and begins.nanosec == 0:
        return 0.0
    elapsed_s = (since_1970_ns - begins.sec * 1_000_000_000 - begins.nanosec) / 1e9
    if elapsed_s >= length_s:
        raise JointsError(
            f"it was over {elapsed_s - length_s:.1f} s ago by its stamp (does its clock agree with ours?)"
        )
    if elapsed_s < -MAX_S:
        raise JointsError(f"it begins in {-elapsed_s:.1f} s by its stamp; at most {MAX_S:g} s ahead are taken")
    return elapsed_s


def _seconds(duration: Duration) -> float:
    return duration.sec + duration.nanosec / 1e9
