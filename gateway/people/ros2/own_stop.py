"""Which emergency stop ROS may end: one that ROS alone engaged while the bridge drove. Pure.

The gateway numbers emergency stops. The bridge reads the latest number when it begins to drive, while none is engaged.
If the next number is of its own request, nobody else has engaged one in between.
"""

from typing import Final

from schemas.telemetry import GatewayState

SAME_RUN_S: Final = 1.0
"""A gateway that was started again counts from 1, so its start must be the same, give or take a slow answer."""


class OwnStop:
    """Decides whether ROS may end the emergency stop. In doubt it is somebody else's, and a person ends it."""

    def __init__(self) -> None:  # mutants accepted (Forget, Step): set before it is read
        self._latest: int | None = None
        """The emergency stop's number before the bridge's own; None: unknown."""
        self._number: int | None = None
        self._began_s = 0.0

    def drives(self, state: GatewayState, now_s: float) -> None:
        """Record that the bridge begins to drive in this state, while no emergency stop is engaged."""
        self._latest, self._number, self._began_s = state.estop, None, now_s - state.uptime_s

    def engaged(self, number: int | None, *, drove: bool) -> None:
        """Record the number of an emergency stop that ROS requested; `drove`: the bridge drove at that time."""
        before = self._latest if drove else self._number
        own = number if before is not None and number == before + 1 else None
        self._latest = self._number = own

    def forget(self) -> None:
        """Record that the bridge was released, or that somebody else drives."""
        self._latest = self._number = None

    def may_leave(self, state: GatewayState, now_s: float) -> int | None:
        """Return the number that a reset may name; None: ROS must not leave this emergency stop."""
        same_run = abs(now_s - state.uptime_s - self._began_s) <= SAME_RUN_S
        return self._number if same_run and state.estop == self._number else None
