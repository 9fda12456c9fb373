"""`ros2`: a session to the gateway, a node in ROS 2's graph, and the way from one to the other until the end.

The bridge publishes of the robot: joint states, what it measures, diagnostics, its description, and frames where they
are wanted. While the gateway is silent, there are no joint states, and the diagnostics are stale.
"""

import math
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ValidationError
from zenoh.handlers import RingChannel

from gateway.errors import ConfigError
from gateway.geometry import load
from gateway.people.client.subscriptions import States
from gateway.people.commands.reach import Connection
from gateway.people.ros2 import BridgeOptions, robot
from gateway.people.ros2 import messages as ros
from gateway.people.ros2.commanded import CommandedJoints
from gateway.people.ros2.driving import Driving
from gateway.people.ros2.joints import JointNames, JointsError
from gateway.people.ros2.parameters import Parameters
from gateway.people.terminal import hint, on_end_signals, say
from gateway.people.walking.motion import ORIGIN
from gateway.words.own_command import install
from schemas import keys
from schemas.calibration import Calibration
from schemas.event import FrameRecord
from schemas.gateway_state import GatewayState
from schemas.telemetry import Telemetry

try:
    from gateway.people.ros2.node import Node, open_on
    from gateway.people.ros2.topics import Topics
except ImportError as error:
    raise ConfigError(
        "the command ros2 needs ROS 2 for this Python: source its setup.bash, or "
        f"{install('rclpy')} (docs/ros2.md; {error})"
    ) from error

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


@dataclass(eq=False)
class Reports:
    """Publishes the gateway's reports as ROS 2 messages; for one thread."""

    received: Mapping[str, Any]
    """The rings of `CHANNELS`, by key."""
    topics: Topics
    parameters: Parameters
    states: States
    hardware_id: str
    with_tf: bool
    is_open: bool
    """Whether other machines may reach the graph."""

    def __post_init__(self) -> None:
        node, unknown_deg = self.topics.node, self.parameters.uncommanded_deg
        self._uncommanded_rad = {} if math.isnan(unknown_deg) else robot.all_at(self.topics.geometry, unknown_deg)
        self.joints = CommandedJoints(self.topics.geometry)
        self._state: GatewayState | None = None
        self._received_s = self._diagnosed_s = self._published_s = 0.0
        self._moved = False
        """Whether a joint has moved since the latest joint states."""
        self._diagnosed: object = None
        self._joint_states = node.publisher("joint_states", ros.JointState)
        self._diagnostics = node.publisher("diagnostics", ros.DiagnosticArray, always=True)
        self._measured = {topic: node.publisher(topic, kind) for topic, kind in robot.MEASURED.items()}
        self._tf = node.publisher("/tf", ros.TFMessage, optional=not self.with_tf)
        self._odom = node.publisher(robot.ODOM, ros.Odometry, optional=True)
        self._at, self._way_m = ORIGIN, 0.0
        """The last odometry, and the length of the way until then (m)."""
        text = robot.description(self.topics.geometry, self.topics.joints.of, self.parameters.base_frame)
        node.publisher("robot_description", ros.String, latched=True)(text)

    def tick(self, now_s: float) -> None:
        """Publish what was received since the last call. `now_s`: monotonic."""
        self._take(keys.CALIBRATION, Calibration)
        state = self._take(keys.STATE, GatewayState, self.states.join)
        if state is not None:
            self._moved = True
            self._state, self._received_s = state, now_s
            self.topics.driving.receive(state)
        while self._take(keys.FRAME, FrameRecord) is not None:
            self._moved = True
        time_ns, base = time.time_ns(), self.parameters.base_frame
        while (telemetry := self._take(keys.TELEMETRY, Telemetry)) is not None:
            for topic, message in robot.measured(telemetry, time_ns, base, self.parameters.imu_frame or base):
                self._measured[topic](message)
        if self._moved and now_s - self._published_s >= 1 / self.parameters.joint_states_hz - PERIOD_S / 2:
            self._moved, self._published_s = False, now_s
            at_rad = self._uncommanded_rad | self.joints.rad
            self._joint_states(robot.joint_state(at_rad, time_ns, self.topics.joints.of))
            if self.with_tf:
                self._tf(robot.frames(self.topics.geometry, at_rad, time_ns, base))
            if (walked := self.topics.driving.odometry) is not None:
                at, velocity = walked
                turned_m = robot.A_TURN_M * abs(at.heading_rad - self._at.heading_rad)
                self._way_m += math.hypot(at.x_m - self._at.x_m, at.y_m - self._at.y_m) + turned_m
                self._at = at
                self._odom(robot.odometry(at, velocity, self._way_m, time_ns, base))
                self._tf(robot.odometry_frame(at, time_ns, base))
        sign = (self._state and self._state.mode, self.topics.driving.does, self.topics.latest_rejection)
        if now_s - self._diagnosed_s >= (1 / self.parameters.diagnostics_hz if sign == self._diagnosed else CHANGED_S):
            self._diagnosed_s, self._diagnosed = now_s, sign
            gateway: tuple[ros.Message, ...] = (
                robot.status("gateway", ros.STALE, "nothing is received from the gateway"),
            )
            if self._state is not None and now_s - self._received_s <= SILENT_S:
                gateway = robot.diagnostics(self._state)
            self._diagnostics(robot.diagnostic_array((*gateway, self._bridge()), time_ns, self.hardware_id))

    def _take(self, key: str, kind: type[R], read: Callable[[bytes], R | None] | None = None) -> R | None:
        """Return the next valid report on a key: without access control anybody may publish there."""
        sample = self.received[key].handler.try_recv()
        if sample is None:
            return None
        try:
            report = (read or kind.model_validate_json)(sample.payload.to_bytes())
        except ValidationError:
            return None
        if report is not None:
            self.joints.take(key, report.model_dump(mode="json"))
        return report

    def _bridge(self) -> ros.Message:
        counts = {"taken": self.topics.taken, "rejected": self.topics.rejected}
        return robot.status(
            "ROS 2 bridge",
            ros.WARN if self.is_open else ros.OK,
            f"{self.topics.driving.does}{OPEN if self.is_open else ''}",
            drives=self.topics.driving.drives,
            open_graph=self.is_open,
            **{f"{what} {topic}": count for what, found in counts.items() for topic, count in sorted(found.items())},
            latest_rejection=self.topics.latest_rejection or None,
        )


OPEN_NAME: Final = "ros2 (open graph)"
"""The driver's name in state and events if other machines may reach the graph."""
WATCH_S: Final = 0.05


def serve(connect: Callable[[str], Connection], options: BridgeOptions) -> int:
    """Serve until a signal; `connect` takes the name by which the gateway knows us. Returns the exit code.

    Raises ConfigError, ZenohError.
    """
    parameters = Parameters(
        options.joint_states_hz,
        options.diagnostics_hz,
        options.base_frame,
        options.imu_frame,
        math.nan if options.uncommanded_deg is None else options.uncommanded_deg,
    )
    try:
        joints = JointNames(options.joint_names)
    except JointsError as error:
        raise ConfigError(f"--joint-names: {error}") from error
    shape = load(options.geometry)
    ended = threading.Event()
    with closing(Node(options.domain, options.namespace, options.ros_args or [])) as node:
        if is_open := bool(found := sorted(set(open_on()))):
            hint(
                f"ROS 2's graph is open to the network ({node.rmw} has sockets on {', '.join(found)}): all who reach "
                "it can drive the robot. To keep it on this machine: docs/ros2.md#who-reaches-the-graph"
            )
        name = OPEN_NAME if is_open else "ros2"
        with connect(name)() as client, on_end_signals(ended.set), ExitStack() as at_the_end:
            driving = Driving(client, name, shape, hint)
            at_the_end.callback(node.close)
            topics = Topics(node, driving, shape, joints, hint)
            node.serve("estop", driving.estop, always=True)
            received = {key: client.session.declare_subscriber(key, ring) for key, ring in CHANNELS.items()}
            reports = Reports(
                received,
                topics,
                node.parameters(parameters),
                client.states,
                hardware_id=options.namespace.strip("/") or node.get_name(),
                with_tf=options.tf,
                is_open=is_open,
            )
            reports.joints.take(keys.CALIBRATION, client.calibration().model_dump(mode="json"))
            topics.subscribe()
            node.serve("reset", partial(driving.reset, allowed=options.allow_reset))
            node.serve("drive", driving.drive)
            node.serve("release", driving.release)
            watch = threading.Thread(target=_watch, args=(ended, driving), name="watch the motion", daemon=True)
            watch.start()
            at_the_end.callback(watch.join)
            at_the_end.callback(ended.set)
            at_the_end.callback(driving.close)  # first: its legs are stopped before it waits for anything
            node.manage(partial(driving.activate, drives=options.drive), driving.deactivate)
            named = f"{node.get_fully_qualified_name()} is in ROS 2's graph of {node.rmw}"
            say(f"{named}, domain {options.domain}; Ctrl-C ends")
            while not ended.wait(PERIOD_S):
                topics.record_alive()
                reports.tick(time.monotonic())
    return 0


def _watch(ended: threading.Event, driving: Driving) -> None:
    while not ended.wait(WATCH_S):
        driving.check()
