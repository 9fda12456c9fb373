"""Add a wire: a class of 20 lines, and an entry point in the group `hexapod_gateway.wires`.

    [project.entry-points."hexapod_gateway.wires"]
    my-board = "my_board:MyBoard"        # [wire] name = "my-board" in gateway.toml chooses it

A plug-in imports only this module of the gateway. The gateway has the lease, watchdog, emergency stop, limits and
calibration, as on any wire. docs/protocol.md lists what a plug-in may rely on. `check --wire` tries it.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

GROUP: Final = "hexapod_gateway.wires"
"""The entry points' group."""


class Capabilities(NamedTuple):
    """A wire's capabilities. Everything above a wire decides by these, never by the wire's name."""

    whole_robot: bool = False
    """Whether only all servos together can be started and stopped."""
    acknowledges: bool = False
    """`apply` returns only after the controller has confirmed the frame."""


class ServoWire(ABC):
    """The way to eighteen servos. Its methods are called by one thread at a time, from `open` to `close`."""

    capabilities = Capabilities()

    def __init__(self, options: Mapping[str, object]) -> None:  # noqa: B027  (a plug-in may have no options)
        """`options`: the other keys of [wire]. Raises ValueError with a sentence for a bad one. Touches no device."""

    @abstractmethod
    def open(self) -> None:
        """Open the device anew. Raises OSError if it cannot be opened; the gateway tries again every 20 ms."""

    @abstractmethod
    def apply(self, changes: Sequence[tuple[int, float | None]]) -> None:
        """Write these changes. Raises OSError on a fault; the gateway then reopens the wire and stops all servos.

        `changes`: a servo's id (11 to 63: leg and joint) and its angle in degrees (0 to 180), or None: no holding
        torque. One call has only stops, or none. A stopped servo starts with its first angle.
        """

    @abstractmethod
    def close(self) -> None:
        """Release the device, if it is open. Never raises."""
