"""What comes from ROS peers: checked, read and handed to `Driving`; what is not taken is counted, with its reason."""

import threading
import time
from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from gateway.geometry import Geometry
from gateway.model.staleness import Staleness
from gateway.people.bridge.driving import Driving, NotTakenError
from gateway.people.bridge.graph import Arrived, Present, presence
from gateway.people.ros2.joints import JointNames, check_reach, positions
from gateway.people.ros2.messages import (
    Float64,
    Header,
    Int32,
    JointState,
    JointTrajectory,
    Message,
    Time,
    Twist,
    TwistStamped,
)
from gateway.people.ros2.rivals import SILENT_S, Rivals
from gateway.people.ros2.trajectory import Trajectory
from gateway.people.walking import Velocity
from gateway.people.walking.gaits import NUMBERS

if TYPE_CHECKING:
    from gateway.people.bridge.node import Node

_MAX_BYTES: Final = 4096
"""As a command to the gateway; 18 joints with velocity and effort have 1000."""
MAX_TRAJECTORY_BYTES: Final = 1_000_000
"""2000 points of 18 joints with velocities have 650 000."""
MAX_AGE_MS: Final = 500.0
"""As `limits.max_age_ms`: what a link held back for longer is not taken."""

_MOST_APART_NS: Final = 10 * 365 * 86_400_000_000_000
"""Ten years: no clock that was ever set is so far off, and no bag is so old. Simulated time, and the clock of a machine
that knows no time yet, begin in 1970."""

Taken = Callable[[Any, Arrived], None]
"""Takes a message of the topic's type."""


class Topics:
    """The topics that come in, and how many of their messages were taken, or were not."""

    def __init__(
        self, driving: Driving, geometry: Geometry, joints: JointNames, present: Present, show: Callable[[str], None]
    ) -> None:
        """`present`: who sends trajectories. `show` takes lines for a person, each reason once."""
        self._driving = driving
        self._geometry = geometry
        self._joints = joints
        self._present = present
        self._show = show
        self._lock = threading.Lock()
        self._ages = Staleness(MAX_AGE_MS)
        walking = Rivals()
        self._rivals = {"joint_commands": Rivals(), "cmd_vel": walking, "cmd_vel_stamped": walking}
        self._shown: set[str] = set()
        self.taken: Counter[str] = Counter()
        self.rejected: Counter[str] = Counter()
        self.latest_rejection = ""

    def subscribe(self, node: "Node") -> None:
        """Take messages from now on; they move nothing before the bridge drives."""
        stand = self._driving.stand
        table: dict[str, tuple[Taken, type[Message]]] = {
            "joint_commands": (self._joint_commands, JointState),
            "joint_trajectory": (self._joint_trajectory, JointTrajectory),
            "cmd_vel": (self._go, Twist),
            "cmd_vel_stamped": (self._go, TwistStamped),
            "cmd_base_height": (lambda found, _: stand(height_m=found.data), Float64),
            "roll_setpoint": (lambda found, _: stand(roll_rad=found.data), Float64),
            "pitch_setpoint": (lambda found, _: stand(pitch_rad=found.data), Float64),
            "cmd_gait_type": (self._gait, Int32),
        }
        for topic, (take, kind) in table.items():
            most = MAX_TRAJECTORY_BYTES if kind is JointTrajectory else _MAX_BYTES
            node.subscribe(topic, kind, most, partial(self._take, topic, take), partial(self.reject, topic))

    def turned(self) -> None:
        """Ten times a second and more: else what comes after a pause of this process is held for old."""
        with self._lock:
            self._ages.turned(time.monotonic_ns())

    # ---- one for each topic

    def _joint_commands(self, message: JointState, _: Arrived) -> None:
        at_rad = positions(self._joints.servos(message.name), message.position)
        check_reach(self._geometry, at_rad)
        self._driving.joints(at_rad)

    def _joint_trajectory(self, message: JointTrajectory, arrived: Arrived) -> None:
        is_there = presence(arrived.sender, self._present)
        if not is_there():
            raise NotTakenError("its sender is not seen in the graph (any more), and could not take it back")
        plan = Trajectory.read(message, self._joints, self._geometry, time.monotonic(), time.time_ns())
        self._driving.follow(plan, is_there)

    def _go(self, message: Twist | TwistStamped, _: Arrived) -> None:
        twist = message.twist if isinstance(message, TwistStamped) else message
        self._driving.go(Velocity.checked(twist.linear.x, twist.linear.y, twist.angular.z))

    def _gait(self, message: Int32, _: Arrived) -> None:
        gait = NUMBERS.get(message.data)
        if gait is None:
            known = ", ".join(f"{number} {name}" for number, name in NUMBERS.items())
            raise NotTakenError(f"there is no gait {message.data}; there are {known}")
        self._driving.walk_as(gait)

    # ---- all of them

    def _take(self, topic: str, take: Taken, message: Message, arrived: Arrived) -> None:
        try:
            self.check_age(arrived)
            _check_stamp(message)
            rivals, now_s = self._rivals.get(topic), time.monotonic()
            if rivals is not None and not rivals.may_send(arrived.sender, now_s):
                raise NotTakenError(f"another node publishes here, and is followed until it is silent for {SILENT_S} s")
            take(message, arrived)
            if rivals is not None:
                rivals.sent(arrived.sender, now_s)
        except (NotTakenError, ValueError) as error:
            self.reject(topic, str(error))
        else:
            self.taken[topic] += 1

    def check_age(self, arrived: Arrived) -> None:
        """Raises NotTakenError where a link held it back, or its sender's clock was never set."""
        _check_time(arrived.time_ns, "was sent at a time")
        with self._lock:
            now_ns = time.monotonic_ns()
            old = self._ages.too_old(arrived.sender.hex(), arrived.time_ns / 1e6, now_ns, now_ns)
        if old is not None:
            raise NotTakenError(old.replace("the gateway itself", "the bridge itself"))

    def reject(self, topic: str, why: str) -> None:
        """Count what is not taken, and explain it."""
        self.rejected[topic] += 1
        self.latest_rejection = f"{topic}: {why}"
        sign = f"{topic}: {why.translate(_WITHOUT_DIGITS)}"
        if sign not in self._shown and len(self._shown) < _MOST_SHOWN:
            self._shown.add(sign)
            self._show(f"not taken: {topic}: {why}")


def _check_stamp(message: Message) -> None:
    """Raises NotTakenError where its header has a stamp of another time than the robot's; 0 is none."""
    header = getattr(message, "header", None)
    if isinstance(header, Header) and header.stamp != Time():
        _check_time(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec, "has a stamp")


def _check_time(time_ns: int, what: str) -> None:
    """Raises NotTakenError for a time since 1970 that cannot be: `what` happened then."""
    if abs(time.time_ns() - time_ns) > _MOST_APART_NS:
        day = datetime.fromtimestamp(time_ns // 1_000_000_000, UTC).date()
        raise NotTakenError(f"it {what} of {day}, by its sender's clock: is that set, or its time simulated?")


_WITHOUT_DIGITS: Final = str.maketrans("", "", "0123456789")
_MOST_SHOWN: Final = 200
"""Reasons that have a line: strangers choose the names in some of them."""
