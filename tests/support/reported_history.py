"""What a judge of the supervisor remembers of what the robot measures and its power board reports; see `oracle.py`."""

from collections.abc import Collection, Sequence

from gateway.robot.core.events import BodyMeasured, Effect, Event, PowerSeen
from gateway.robot.core.leg import Rules
from schemas.telemetry import Kind, Reason
from tests.support.history import demand, is_announced


class BodyHistory:
    """What the latest measurements have said of the battery and the body."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self.low = self.fallen = False
        self.tilted_ns: int | None = None
        """The first measurement of the present time beyond the limit."""

    def key(self, now_ns: int) -> tuple[object, ...]:
        """What of it still matters."""
        age_ns = None if self.tilted_ns is None else min(now_ns - self.tilted_ns, self.rules.tilt_ns)
        return self.low, self.fallen, age_ns

    def judge(self, event: BodyMeasured | None, now_ns: int, effects: Sequence[Effect]) -> None:
        """Take a measurement, and judge what is announced of it; None: another event came, and nothing is."""
        before = self.low, self.fallen
        if event is not None:
            self._take(event, now_ns)
        kinds = [is_announced(effects, kind) for kind in (Kind.BATTERY_LOW, Kind.FALLEN)]
        demand(kinds[0] == (self.low and not before[0]), "a battery is announced once when it becomes low")
        demand(kinds[1] == (self.fallen and not before[1]), "a fall is announced once")

    def _take(self, event: BodyMeasured, now_ns: int) -> None:
        limit_mv = self.rules.min_battery_mv
        if event.battery_mv < limit_mv:
            self.low = True
        elif event.battery_mv >= limit_mv + limit_mv // 50:
            self.low = False
        if event.tilt_cdeg is not None:
            beyond = 0 < self.rules.max_tilt_cdeg < event.tilt_cdeg
            if not beyond:
                self.tilted_ns, self.fallen = None, False
            elif self.tilted_ns is None:
                self.tilted_ns = now_ns
        if self.tilted_ns is not None and now_ns - self.tilted_ns >= self.rules.tilt_ns:
            self.fallen = True


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
