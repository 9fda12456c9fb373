"""What a wire to the robot's controller can do. Everything above a wire decides by this, never by the wire's name."""

from typing import NamedTuple


class Capabilities(NamedTuple):
    """What depends on the wire."""

    whole_robot: bool = False
    """Only all servos together can be started and stopped."""
    measures: bool = False
    """Telemetry comes back, and with it whether the controller is alive."""
    acknowledges: bool = False
    """A frame counts as written only once the controller has confirmed it."""
    supply_starts: bool = False
    """Where a power board feeds the servos, supply is what starts each: its angle is on the wire before."""
