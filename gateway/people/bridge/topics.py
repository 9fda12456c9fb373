"""What comes from ROS peers: checked, read and handed to `Driving`; what is not taken is counted, with its reason."""

import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Final, TypeVar

import zenoh

from gateway.geometry import Geometry
from gateway.model.staleness import Staleness
from gateway.people.bridge.driving import Driving, NotTakenError
from gateway.people.bridge.motions import GAIT_NUMBERS
from gateway.people.bridge.node import Senders
from gateway.people.ros2.cdr import Message, decode
from gateway.people.ros2.joints import check_reach, positions, servos_of
from gateway.people.ros2.messages import Float64, Int32, JointState, JointTrajectory, Twist, TwistStamped
from gateway.people.ros2.trajectory import Trajectory
from gateway.people.ros2.wire import Attachment, Names, WireError
from gateway.people.walking import Velocity

MAX_BYTES: Final = 4096
"""As a command to the gateway; 18 joints with velocity and effort have 1000."""
MAX_TRAJECTORY_BYTES: Final = 1_000_000
"""2000 points of 18 joints with velocities have 650 000."""
MAX_AGE_MS: Final = 500.0
"""As `limits.max_age_ms`: what a link held back for longer is not taken."""

M = TypeVar("M", bound=Message)
N = TypeVar("N", bound=Message)


class Topics:
    """The topics that come in, and how many of their messages were taken, or were not."""

    def __init__(
        self, driving: Driving, geometry: Geometry, names: Names, senders: Senders, show: Callable[[str], None]
    ) -> None:
        """`senders`: of trajectories. `show` takes lines for a person, each reason once."""
        self._driving = driving
        self._geometry = geometry
        self._names = names
        self._senders = senders
        self._show = show
        self._lock = threading.Lock()
        self._ages = Staleness(MAX_AGE_MS)
        self._shown: set[str] = set()
        self.taken: Counter[str] = Counter()
        self.rejected: Counter[str] = Counter()
        self.latest_rejection = ""

    def table(self) -> dict[str, tuple[type[Message], Callable[[zenoh.Sample], None]]]:
        """Topic → its type, and what takes its samples."""
        return {
            "joint_commands": self._entry("joint_commands", JointState, self._joint_commands),
            "joint_trajectory": self._entry("joint_trajectory", JointTrajectory, self._joint_trajectory),
            "cmd_vel": self._entry("cmd_vel", Twist, self._go, TwistStamped),
            "cmd_vel_stamped": self._entry("cmd_vel_stamped", TwistStamped, self._go, Twist),
            "cmd_base_height": self._entry(
                "cmd_base_height", Float64, lambda found, _: self._driving.stand(height_m=found.data)
            ),
            "roll_setpoint": self._entry(
                "roll_setpoint", Float64, lambda found, _: self._driving.stand(roll_rad=found.data)
            ),
            "pitch_setpoint": self._entry(
                "pitch_setpoint", Float64, lambda found, _: self._driving.stand(pitch_rad=found.data)
            ),
            "cmd_gait_type": self._entry("cmd_gait_type", Int32, self._gait),
        }

    def turned(self) -> None:
        """Ten times a second and more: else what comes after a pause of this process is held for old."""
        with self._lock:
            self._ages.turned(time.monotonic_ns())

    # ---- one for each topic

    def _joint_commands(self, message: JointState, _: Attachment) -> None:
        at_rad = positions(servos_of(message.name), message.position)
        check_reach(self._geometry, at_rad)
        self._driving.joints(at_rad)

    def _joint_trajectory(self, message: JointTrajectory, sender: Attachment) -> None:
        is_there = self._senders.watch(sender.gid)
        if not is_there():
            raise NotTakenError("its sender is not seen in the graph (any more), and could not take it back")
        plan = Trajectory.read(message, self._geometry, time.monotonic(), time.time_ns())
        self._driving.follow(plan, is_there)

    def _go(self, message: Twist | TwistStamped, _: Attachment) -> None:
        twist = message.twist if isinstance(message, TwistStamped) else message
        self._driving.go(Velocity.checked(twist.linear.x, twist.linear.y, twist.angular.z))

    def _gait(self, message: Int32, _: Attachment) -> None:
        gait = GAIT_NUMBERS.get(message.data)
        if gait is None:
            known = ", ".join(f"{number} {name}" for number, name in GAIT_NUMBERS.items())
            raise NotTakenError(f"there is no gait {message.data}; there are {known}")
        self._driving.walk_as(gait)

    # ---- all of them

    def _entry(
        self, topic: str, kind: type[M], take: Callable[[M | N, Attachment], None], also: type[N] | None = None
    ) -> tuple[type[Message], Callable[[zenoh.Sample], None]]:
        """The graph shows the topic as of `kind`; `also`: of this type a message is taken, too."""

        def took(sample: zenoh.Sample) -> None:
            try:
                if also is not None and str(sample.key_expr) == self._names.topic_key(topic, also):
                    take(*self._read(topic, also, sample))
                else:
                    take(*self._read(topic, kind, sample))
            except (NotTakenError, ValueError) as error:
                self._reject(topic, str(error))
            else:
                self.taken[topic] += 1

        return kind, took

    def _read(self, topic: str, kind: type[M], sample: zenoh.Sample) -> tuple[M, Attachment]:
        """Raises WireError, CdrError, NotTakenError."""
        key = str(sample.key_expr)
        if key != self._names.topic_key(topic, kind):
            raise WireError(self._other_type(key, kind))
        size = len(sample.payload)
        most = MAX_TRAJECTORY_BYTES if kind is JointTrajectory else MAX_BYTES
        if size > most:
            raise WireError(f"it has {size} bytes, and at most {most} are taken")
        found = sample.attachment
        attachment = Attachment.from_bytes(None if found is None else found.to_bytes())
        with self._lock:
            now_ns = time.monotonic_ns()
            old = self._ages.too_old(attachment.gid.hex(), attachment.time_ns / 1e6, now_ns, now_ns)
        if old is not None:
            raise NotTakenError(old.replace("the gateway itself", "the bridge itself"))
        return decode(kind, sample.payload.to_bytes()), attachment

    def _other_type(self, key: str, kind: type[Message]) -> str:
        *_, type_name, type_hash = key.split("/")
        wanted = self._names.topic_key("", kind).split("/")[-2:]
        if type_name != wanted[0]:
            return f"it is a {type_name[:80]}, and this topic has {kind.TYPE}"
        return f"its {kind.TYPE} has the hash {type_hash[:20]}…, and ours {wanted[1][:20]}…: another distribution?"

    def _reject(self, topic: str, why: str) -> None:
        self.rejected[topic] += 1
        self.latest_rejection = f"{topic}: {why}"
        sign = f"{topic}: {why.translate(_WITHOUT_DIGITS)}"
        if sign not in self._shown and len(self._shown) < _MOST_SHOWN:
            self._shown.add(sign)
            self._show(f"not taken: {topic}: {why}")


_WITHOUT_DIGITS: Final = str.maketrans("", "", "0123456789")
_MOST_SHOWN: Final = 200
"""Reasons that have a line: strangers choose the names in some of them."""
