"""Check and read messages of ROS peers, and hand them to `Driving`; rejections are counted by reason."""

import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

from gateway.geometry import Geometry
from gateway.model.staleness import Staleness
from gateway.people.ros2.driving import Driving, NotTakenError
from gateway.people.ros2.joints import JointNames, check_reach, positions_of
from gateway.people.ros2.node import Node
from gateway.people.ros2.received import SILENT_S, Rivals
from gateway.people.walking.gaits import NUMBERS
from gateway.people.walking.motion import Velocity

_MAX_BYTES: Final = 4096
"""The limit of a command to the gateway; 18 joints with velocity and effort take 1000."""
MAX_AGE_MS: Final = 500.0
"""The oldest message accepted, as by `limits.max_age_ms`: a link may hold messages back."""

_MOST_APART_NS: Final = 10 * 365 * 86_400_000_000_000
"""Ten years: no clock that was ever set is so far off, and no bag is so old. Simulated time, and the clock of a machine
that knows no time yet, begin in 1970."""
_WITHOUT_DIGITS: Final = str.maketrans("", "", "0123456789")
_MOST_SHOWN: Final = 200
"""Most reasons that get a line: other programs choose the names in some of them."""
Take = Callable[[Any], bool | None]
"""Takes a message. Returns False if the message claims nothing: others may publish, too."""


@dataclass(eq=False)
class Topics:
    """The subscribed topics, with counts of taken and rejected messages."""

    node: Node
    driving: Driving
    geometry: Geometry
    joints: JointNames
    show: Callable[[str], None]
    """Receives lines for a person, each reason once."""

    def __post_init__(self) -> None:
        self._lock = threading.Lock()
        self._ages = Staleness(MAX_AGE_MS)
        walking = Rivals()
        self._rivals = {"joint_commands": Rivals(), "cmd_vel": walking, "cmd_vel_stamped": walking}
        self._shown: set[str] = set()
        self.taken: Counter[str] = Counter()
        self.rejected: Counter[str] = Counter()
        self.latest_rejection = ""

    def subscribe(self) -> None:
        """Take messages from now on; they move nothing before the bridge drives."""
        stand = self.driving.stand
        table: dict[str, tuple[str, Take]] = {
            "joint_commands": ("sensor_msgs/msg/JointState", self._joint_commands),
            "cmd_vel": ("geometry_msgs/msg/Twist", self._go),
            "cmd_vel_stamped": ("geometry_msgs/msg/TwistStamped", lambda found: self._go(found.twist)),
            "cmd_base_height": ("std_msgs/msg/Float64", lambda found: stand(height_m=found.data)),
            "roll_setpoint": ("std_msgs/msg/Float64", lambda found: stand(roll_rad=found.data)),
            "pitch_setpoint": ("std_msgs/msg/Float64", lambda found: stand(pitch_rad=found.data)),
            "cmd_gait_type": ("std_msgs/msg/Int32", lambda found: self._gait(found.data)),
        }
        for topic, (kind, take) in table.items():
            self.node.subscribe(topic, kind, _MAX_BYTES, partial(self._take, topic, take), partial(self.reject, topic))

    def record_alive(self) -> None:
        """Record that the process is alive. Call it at least ten times a second: else messages count as old."""
        with self._lock:
            self._ages.record_alive(time.monotonic_ns())

    # ---- one for each topic

    def _joint_commands(self, message: Any) -> None:
        at_rad = positions_of(self.joints.servos(message.name), message.position)
        check_reach(self.geometry, at_rad)
        self.driving.joints(at_rad)

    def _go(self, twist: Any) -> bool:
        velocity = Velocity.checked(twist.linear.x, twist.linear.y, twist.angular.z)
        self.driving.go(velocity)
        return velocity.moves

    def _gait(self, number: int) -> None:
        gait = NUMBERS.get(number)
        if gait is None:
            known = ", ".join(f"{each} {name}" for each, name in NUMBERS.items())
            raise NotTakenError(f"there is no gait {number}; there are {known}")
        self.driving.walk_as(gait)

    # ---- all of them

    def _take(self, topic: str, take: Take, message: Any, sender: bytes, sent_ns: int) -> None:
        try:
            _check_time(sent_ns, "was sent at a time")
            with self._lock:
                now_ns = time.monotonic_ns()
                old = self._ages.too_old(sender.hex(), sent_ns / 1e6, now_ns, now_ns)
            if old is not None:  # a link held it back
                raise NotTakenError(old.replace("the gateway itself", "the bridge itself"))
            if (header := getattr(message, "header", None)) is not None:
                stamp_ns = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
                if stamp_ns:  # 0: it has none
                    _check_time(stamp_ns, "has a stamp")
            rivals, now_s = self._rivals.get(topic), time.monotonic()
            if rivals is not None and not rivals.may_send(sender, now_s):
                raise NotTakenError(f"another node publishes here, and is followed until it is silent for {SILENT_S} s")
            if take(message) is not False and rivals is not None:
                rivals.sent(sender, now_s)
        except (NotTakenError, ValueError) as error:
            self.reject(topic, str(error))
        else:
            self.taken[topic] += 1

    def reject(self, topic: str, why: str) -> None:
        """Count a rejected message, and show each reason once."""
        self.rejected[topic] += 1
        self.latest_rejection = f"{topic}: {why}"
        sign = self.latest_rejection.translate(_WITHOUT_DIGITS)
        if sign not in self._shown and len(self._shown) < _MOST_SHOWN:
            self._shown.add(sign)
            self.show(f"not taken: {self.latest_rejection}")


def _check_time(time_ns: int, what: str) -> None:
    """Raise NotTakenError for an impossible time (since 1970) of `what`."""
    if abs(time.time_ns() - time_ns) > _MOST_APART_NS:
        day = datetime.fromtimestamp(time_ns // 1_000_000_000, UTC).date()
        raise NotTakenError(f"it {what} of {day}, by its sender's clock: is that set, or its time simulated?")
