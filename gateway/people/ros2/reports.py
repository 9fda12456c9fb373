"""What the bridge publishes of the robot: joint states, what it measures, diagnostics, its description, and frames
where they are wanted.

Only what the gateway publishes: while it is silent, there are no joint states, and the diagnostics are stale.
"""

import math
import time
from collections.abc import Callable, Mapping
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ValidationError
from zenoh.handlers import RingChannel

from gateway.errors import ConfigError
from gateway.geometry import Geometry
from gateway.people.client.subscriptions import States
from gateway.people.ros2 import messages as ros
from gateway.people.ros2 import robot
from gateway.people.ros2.commanded import CommandedJoints
from gateway.people.ros2.driving import Driving
from gateway.people.ros2.node import Node
from gateway.people.ros2.parameters import Parameters
from gateway.people.ros2.topics import Topics
from gateway.people.walking.motion import ORIGIN
from schemas import keys
from schemas.calibration import Calibration
from schemas.telemetry import FrameRecord, GatewayState, Telemetry

PERIOD_S: Final = 0.02
"""Period of `tick`: at most 50 joint states a second."""
SILENT_S: Final = 1.0
"""A gateway publishes its state ten times a second."""
CHANGED_S: Final = 0.1
"""Shorter period of diagnostics after a change of the mode or of what the bridge does."""
OPEN: Final = "; the graph is open: all who reach it can drive the robot"
CHANNELS: Final[dict[str, Any]] = {
    keys.CALIBRATION: RingChannel(1),
    keys.STATE: RingChannel(1),
    keys.TELEMETRY: RingChannel(8),  # at its highest rate, those of four periods
    keys.FRAME: RingChannel(256),  # of six legs at 50 Hz, those of 0.8 s
}
"""The gateway's keys that it reads; only the newest report counts."""

R = TypeVar("R", bound=BaseModel)


def _publisher(
    node: Node, topic: str, kind: type[ros.Message], *, needed: bool = False
) -> Callable[[ros.Message], None]:
    """Return a publisher on a topic; None if this ROS 2 lacks the type. Raises ConfigError if the topic is `needed`."""
    try:
        return node.publisher(topic, kind)
    except ConfigError:
        if needed:
            raise
        return lambda _: None


class Reports:
    """Publishes the gateway's reports as ROS 2 messages; for one thread."""

    def __init__(
        self,
        received: Mapping[str, Any],
        node: Node,
        geometry: Geometry,
        driving: Driving,
        topics: Topics,
        parameters: Parameters,
        states: States,
        *,
        hardware_id: str,
        with_tf: bool,
        is_open: bool,
    ) -> None:
        """`received`: the rings of `CHANNELS`, by key; `is_open`: other machines may reach the graph."""
        self._parameters = parameters
        self._hardware_id = hardware_id
        unknown_deg = parameters.uncommanded_deg
        self._uncommanded_rad = {} if math.isnan(unknown_deg) else robot.all_at(geometry, unknown_deg)
        self._is_open = is_open
        self._received = received
        self._geometry = geometry
        self._driving = driving
        self._topics = topics
        self._joints = CommandedJoints(geometry)
        self._states = states
        self._state: GatewayState | None = None
        self._received_s = self._diagnosed_s = self._published_s = 0.0
        self._moved = False
        """Whether a joint has moved since the latest joint states."""
        self._diagnosed: object = None
        self._joint_states = node.publisher("joint_states", ros.JointState)
        self._diagnostics = node.publisher("diagnostics", ros.DiagnosticArray, always=True)
        self._measured = {topic: node.publisher(topic, kind) for topic, kind in robot.MEASURED.items()}
        self._with_tf = with_tf
        self._tf = _publisher(node, "/tf", ros.TFMessage, needed=with_tf)
        self._odom = _publisher(node, robot.ODOM, ros.Odometry)
        self._at, self._way_m = ORIGIN, 0.0
        """The last odometry, and the length of the way until then (m)."""
        text = robot.description(geometry, topics.joints.of, parameters.base_frame)
        node.publisher("robot_description", ros.String, latched=True)(text)

    def begin(self, calibration: Calibration) -> None:
        """Set the calibration in force at the start; later changes are received."""
        self._joints.take(keys.CALIBRATION, calibration.model_dump(mode="json"))

    def tick(self, now_s: float) -> None:
        """Publish what was received since the last call. `now_s`: monotonic."""
        self._take(keys.CALIBRATION, Calibration)
        state = self._take(keys.STATE, GatewayState, self._states.join)
        if state is not None:
            self._moved = True
            self._state, self._received_s = state, now_s
            self._driving.receive(state)
        while self._take(keys.FRAME, FrameRecord) is not None:
            self._moved = True
        time_ns, base = time.time_ns(), self._parameters.base_frame
        while (telemetry := self._take(keys.TELEMETRY, Telemetry)) is not None:
            for topic, message in robot.measured(telemetry, time_ns, base, self._parameters.measured_in):
                self._measured[topic](message)
        if self._moved and now_s - self._published_s >= 1 / self._parameters.joint_states_hz - PERIOD_S / 2:
            self._moved, self._published_s = False, now_s
            at_rad = self._uncommanded_rad | self._joints.rad
            self._joint_states(robot.joint_state(at_rad, time_ns, self._topics.joints.of))
            if self._with_tf:
                self._tf(robot.frames(self._geometry, at_rad, time_ns, base))
            self._walked(time_ns, base)
        sign = (self._state and self._state.mode, self._driving.does, self._topics.latest_rejection)
        if now_s - self._diagnosed_s >= (1 / self._parameters.diagnostics_hz if sign == self._diagnosed else CHANGED_S):
            self._diagnosed_s, self._diagnosed = now_s, sign
            statuses = (*self._gateway(now_s), self._bridge())
            self._diagnostics(robot.diagnostic_array(statuses, time_ns, self._hardware_id))

    def _walked(self, time_ns: int, base: str) -> None:
        """Publish odometry and its frame while the bridge walks the robot."""
        if (walked := self._driving.odometry) is None:
            return
        at, velocity = walked
        turned_m = robot.A_TURN_M * abs(at.heading_rad - self._at.heading_rad)
        self._way_m += math.hypot(at.x_m - self._at.x_m, at.y_m - self._at.y_m) + turned_m
        self._at = at
        self._odom(robot.odometry(at, velocity, self._way_m, time_ns, base))
        self._tf(robot.odometry_frame(at, time_ns, base))

    def _take(self, key: str, kind: type[R], read: Callable[[bytes], R | None] | None = None) -> R | None:
        """Return the next valid report on a key: without access control anybody may publish there."""
        sample = self._received[key].handler.try_recv()
        if sample is None:
            return None
        try:
            report = (read or kind.model_validate_json)(sample.payload.to_bytes())
        except ValidationError:
            return None
        if report is not None:
            self._joints.take(key, report.model_dump(mode="json"))
        return report

    def _gateway(self, now_s: float) -> tuple[ros.Message, ...]:
        if self._state is None or now_s - self._received_s > SILENT_S:
            return (robot.status("gateway", ros.STALE, "nothing is received from the gateway"),)
        return robot.diagnostics(self._state)

    def _bridge(self) -> ros.Message:
        counts = {"taken": self._topics.taken, "rejected": self._topics.rejected}
        return robot.status(
            "ROS 2 bridge",
            ros.WARN if self._is_open else ros.OK,
            f"{self._driving.does}{OPEN if self._is_open else ''}",
            drives=self._driving.drives,
            open_graph=self._is_open,
            **{f"{what} {topic}": count for what, found in counts.items() for topic, count in sorted(found.items())},
            latest_rejection=self._topics.latest_rejection or None,
        )
