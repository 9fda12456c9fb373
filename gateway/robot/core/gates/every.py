"""Asks all gates when a servo's next frame may leave. A new gate is a file in this folder, and a line in `Gates`."""

from collections.abc import Mapping
from typing import Protocol

from gateway.robot.core.gates.burst import BurstGate
from gateway.robot.core.gates.stagger import Stagger
from gateway.robot.core.gates.supply import PowerGate
from gateway.robot.core.gates.whole import WholeGate
from gateway.robot.core.leg import Leg
from gateway.robot.core.rules import Rules
from gateway.robot.core.servo import Servo


class Gate(Protocol):
    """Delays the starts of servos."""

    def opens_ns(self, servo: Servo) -> int:
        """Return when this waiting servo may start (ns), or NEVER until another event opens the gate."""


class Gates:
    """All gates of a start. A running servo waits for its leg's rate slot alone."""

    def __init__(self, rules: Rules, legs: Mapping[int, Leg]) -> None:
        self.supply = PowerGate(rules, legs)
        self.stagger = Stagger(rules.start_pause_ns)
        self.burst = BurstGate()
        whole = [WholeGate(legs)] if rules.starts_whole else []
        self._gates: tuple[Gate, ...] = (self.burst, self.supply, self.stagger, *whole)

    def opens_ns(self, servo: Servo) -> int:
        """Return when this waiting servo may start, apart from its leg's rate slot (ns).

        NEVER: not until another event opens a gate.
        """
        return max(gate.opens_ns(servo) for gate in self._gates)
