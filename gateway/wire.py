"""What brings a wire of one's own: a class of 20 lines, and an entry point in the group `hexapod_gateway.wires`.

    [project.entry-points."hexapod_gateway.wires"]
    my-board = "my_board:MyBoard"        # [wire] name = "my-board" in gateway.toml chooses it

A plug-in imports this module and nothing else of the gateway. Lease, watchdog, emergency stop, limits and calibration
are the gateway's, as on any wire; docs/protocol.md lists what it may rely on. `check --wire` tries it.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

GROUP: Final = "hexapod_gateway.wires"
"""The entry points' group."""


class Capabilities(NamedTuple):
    """What a wire can do. Everything above a wire decides by this, never by the wire's name."""

    whole_robot: bool = False
    """Only all servos together can be started and stopped."""
    measures: bool = False
    """Telemetry comes back, and with it whether the controller is alive."""
    acknowledges: bool = False
    """A frame counts as written only once the controller has confirmed it: `apply` returns then."""


class ServoWire(ABC):
    """The way to eighteen servos. Its methods are called by one thread at a time, from `open` to `close`."""

    capabilities = Capabilities()

    def __init__(self, options: Mapping[str, object]) -> None:  # noqa: B027  (a plug-in may have no options)
        """`options`: the other keys of [wire]. Raises ValueError with a sentence. Touches no device."""

    @abstractmethod
    def open(self) -> None:
        """Open the device anew. Raises OSError: a fault of the bus; it is tried again every 20 ms."""

    @abstractmethod
    def apply(self, changes: Sequence[tuple[int, float | None]]) -> None:
        """Write these and return. Raises OSError: then it is closed, opened, and all servos are stopped.

        `changes`: a servo's id (11 to 63: leg and joint) and its angle in degrees (0 to 180), or None: no holding
        torque. All of one call are stops, or none is. A servo that is stopped starts with its first angle.
        """

    @abstractmethod
    def close(self) -> None:
        """Release the device. Never raises, also where it is not open."""
