"""A node of rclpy with a lifecycle and parameters, as ROS 2 manages its nodes.

rclpy's executor answers these services on one thread: a transition may wait until the robot sits.
"""

import logging
import threading
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, Final

import rclpy
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

from gateway.errors import ConfigError
from gateway.people.bridge.graph import JOIN_S
from gateway.people.bridge.parameters import DESCRIPTIONS, Parameters
from gateway.people.ros2.wire import Names

SIMULATED: Final = "use_sim_time is set, and the time of a robot is real"
_SPIN_S: Final = 0.5
_log: Final = logging.getLogger(__name__)
_INACTIVE: Final = "the node is not active: its lifecycle is managed, and nobody has activated it"


class ManagedNode(LifecycleNode):  # type: ignore[misc]
    """Active once `manage` was called, unless the parameter `autostart` is false; then somebody else activates it."""

    def __init__(self, names: Names, context: rclpy.Context) -> None:
        """Raises RuntimeError as rclpy does."""
        super().__init__(names.node, namespace=names.namespace, context=context, enable_rosout=False)
        self._begin: Callable[[], None]
        self._end: Callable[[str], None]
        self._executor = SingleThreadedExecutor(context=context)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="ROS 2", daemon=True)

    def declare(self, given: Parameters) -> Parameters:
        """Its parameters, which are read at the start; `given` are their defaults. Raises ConfigError."""
        return Parameters(
            **{name: self._declared(name, value, DESCRIPTIONS[name]) for name, value in asdict(given).items()}
        )

    def manage(self, activate: Callable[[], None], deactivate: Callable[[str], None]) -> None:
        """See Graph. Raises ConfigError."""
        self._begin, self._end = activate, deactivate
        deactivate(_INACTIVE)
        self.add_on_set_parameters_callback(_keep_time_real)
        if self._declared("autostart", True, "whether it configures and activates itself at its start"):
            self.trigger_configure()
            self.trigger_activate()
        self._executor.add_node(self)
        self._thread.start()

    def close(self) -> None:
        """Answer no more."""
        self._closed.set()
        self._executor.wake()
        if self._thread.is_alive():
            self._thread.join(JOIN_S)
        self._executor.shutdown(JOIN_S)
        self.destroy_node()

    def _spin(self) -> None:
        while not self._closed.is_set():
            try:
                self._executor.spin_once(_SPIN_S)
            except Exception:  # of one request: others are answered
                _log.exception("a request to the node could not be answered")

    def _declared(self, name: str, value: Any, description: str) -> Any:
        try:
            return self.declare_parameter(
                name, value, ParameterDescriptor(description=description, read_only=True)
            ).value
        except ParameterException as error:
            raise ConfigError(f"parameter {name}: {error}") from error

    # ---- transitions; each takes the state before it

    def on_activate(self, state: Any) -> Any:
        """Somebody may call `drive` from now on."""
        if self.get_parameter("use_sim_time").value:
            self._end(SIMULATED)
            self.get_logger().error(SIMULATED)
            return TransitionCallbackReturn.FAILURE
        self._begin()
        return super().on_activate(state)

    def on_deactivate(self, state: Any) -> Any:
        """The robot sits down, its servos are stopped, and nobody may drive."""
        self._end(_INACTIVE)
        return super().on_deactivate(state)

    def on_shutdown(self, state: Any) -> Any:
        """The same, for good; the emergency stop is served on."""
        self._end("the node was shut down")
        return super().on_shutdown(state)

    def on_error(self, state: Any) -> Any:
        """The same, until it is configured and activated again."""
        self._end(_INACTIVE)
        return super().on_error(state)


def _keep_time_real(parameters: list[Any]) -> Any:
    simulated = any(each.name == "use_sim_time" and each.value for each in parameters)
    return SetParametersResult(successful=not simulated, reason=SIMULATED if simulated else "")
