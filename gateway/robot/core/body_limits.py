"""Forbids starts on an empty battery, and all motion of a body that has fallen. Pure.

- With a limit, nothing starts before the battery's first measurement: an unknown battery may be empty.
- The battery is low from the first measurement below `min_battery_mv` until one is `RECOVERS` above it. Meanwhile
  no stopped servo starts. Running servos continue, since a Stop would let the robot fall.
- The body has fallen once it has been tilted beyond `max_tilt_cdeg` for `tilt_ns`: it fell, or was lifted. Nothing
  starts or moves until a measurement is within the limit. An unknown tilt neither begins nor ends that time, and does
  not show that the body stands.

Only measurements advance the time here. The bus reports missing ones as a fault (`BusFailed`).
"""

from typing import Any, Final

from gateway.rate_limit import NS_PER_MS
from gateway.robot.core.events import Announce, BodyMeasured, Effect
from gateway.robot.core.interlock import ALL_LEGS, Down, Interlock, Why
from gateway.robot.core.legs import Legs
from gateway.robot.core.rules import Rules
from schemas.words import Kind, Reason

RECOVERS: Final = 50
"""A low battery has recovered a fiftieth above the limit, so that a jittering voltage is announced once (assumed)."""


class BodyLimits(Interlock[BodyMeasured]):
    """Reject commands, and bring the robot down, by the latest measurements of battery and tilt."""

    takes = (BodyMeasured,)

    # mutants accepted (Gt_GtE, Step): a step too many does nothing
    def __init__(self, rules: Rules, legs: Legs) -> None:
        super().__init__(rules, legs)
        self.watches = rules.min_battery_mv > 0 or rules.max_tilt_cdeg > 0
        """Whether any measurement matters."""
        self.low = False
        """Whether the battery is too low for a start."""
        self.unknown = self.closed = rules.min_battery_mv > 0
        """Whether the battery has a limit and was not measured yet."""
        self.beyond_ns: int | None = None
        """Since when the body is tilted beyond the limit, or None."""
        limit_deg = rules.max_tilt_cdeg / 100
        self.objection = (
            Reason.FALLEN,
            f"the body is tilted beyond {limit_deg:g} degrees; put it upright, and start it again",
        )

    def why_not(self, request: Any) -> Why | None:
        if self.down is not None:
            return self.objection
        closed = self.low or self.unknown
        if closed and any(not self._legs.servos[servo_id].will_run for servo_id, _ in request.moves):
            if self.unknown:
                return Reason.BATTERY_LOW, "the battery has not been measured yet; nothing starts until it is"
            limit_v = self._rules.min_battery_mv / 1000
            return Reason.BATTERY_LOW, f"the battery is below {limit_v:g} V; nothing starts until it is charged"
        return None

    def take(self, event: BodyMeasured, now_ns: int) -> list[Effect]:
        self.unknown = False
        effects = [*self._battery(event.battery_mv), *self._tilt(event.tilt_cdeg, now_ns)]
        self.closed = self.low or self.down is not None
        return effects

    def _battery(self, battery_mv: int) -> list[Effect]:
        limit_mv = self._rules.min_battery_mv
        before, self.low = self.low, battery_mv < limit_mv + (limit_mv // RECOVERS if self.low else 0)
        if before or not self.low:
            return []
        volts = f"{battery_mv / 1000:g} V, below {limit_mv / 1000:g} V"
        return [Announce(Kind.BATTERY_LOW, f"the battery is at {volts}; nothing starts until it is charged")]

    def _tilt(self, tilt_cdeg: int | None, now_ns: int) -> list[Effect]:
        limit_cdeg = self._rules.max_tilt_cdeg
        if not limit_cdeg:
            return []
        if tilt_cdeg is not None:
            if tilt_cdeg <= limit_cdeg:
                self.beyond_ns = self.down = None
            elif self.beyond_ns is None:
                self.beyond_ns = now_ns
        tilt_ns = self._rules.tilt_ns
        if self.down is not None or self.beyond_ns is None or now_ns < self.beyond_ns + tilt_ns:
            return []
        self.down = Down("the body is tilted", self.beyond_ns + tilt_ns)
        then = self._how_it_comes_down()
        detail = f"the body has been tilted beyond {limit_cdeg / 100:g} degrees for {tilt_ns / NS_PER_MS:g} ms"
        return [Announce(Kind.FALLEN, detail, legs=ALL_LEGS if then else (), done=then)]
