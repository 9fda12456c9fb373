"""What a judge of the supervisor remembers of the power board, and what it demands; see `oracle.py`."""

from collections.abc import Collection

from gateway.robot.core.events import Event, PowerSeen
from gateway.robot.core.leg import Rules
from schemas.telemetry import Reason
from tests.support.history import demand


class PowerHistory:
    """Whether the board answered when it was last seen, and which servos it refused."""

    def __init__(self, rules: Rules) -> None:
        self.silent = rules.power
        """A board that has not answered yet feeds nothing."""
        self.refused: frozenset[int] = frozenset()
        self.fed: frozenset[int] = frozenset()
        """What it has confirmed to feed, of what runs or waits to be started since."""
        self.on = rules.power

    def key(self) -> tuple[object, ...]:
        """What of it still matters."""
        return self.silent, self.refused, self.fed

    def take(self, event: Event) -> None:
        """From now on this is what it has said, if it has said something."""
        if isinstance(event, PowerSeen):
            self.silent, self.refused = not event.alive, frozenset(servo_id for servo_id, _ in event.refused)
            self.fed = event.fed

    def has_not_fed(self, servo_id: int) -> bool:
        """Whether a start of this servo waits for its supply."""
        return self.on and servo_id not in self.fed

    def reason_to_reject(self, moved: Collection[int]) -> Reason | None:
        """Why these servos may neither start nor move."""
        return Reason.NO_POWER if self.silent or not self.refused.isdisjoint(moved) else None

    def after(self, alive: Collection[int], *, lands: bool) -> None:
        """Judge what runs, or waits to be started, at the end of a step."""
        self.fed &= frozenset(alive)
        demand(lands or not self.silent or not alive, "nothing runs while the power board does not answer")
        demand(lands or self.refused.isdisjoint(alive), "nothing runs that the power board refuses to feed")
