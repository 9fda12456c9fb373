"""Starts of two legs are a pause apart: the starting current of eighteen servos can overload the supply. Pure."""

from gateway.robot.core.servo import Servo


class Stagger:  # mutants accepted (Step): a clock begins at 0
    """When the next leg may start. Waiting legs start in the order of their numbers."""

    def __init__(self, pause_ns: int) -> None:
        self.pause_ns = pause_ns
        """0: all legs may start at once."""
        self.next_ns = 0

    def opens_ns(self, servo: Servo) -> int:  # noqa: ARG002
        return self.next_ns

    def started(self, now_ns: int) -> None:
        """Record the start of a leg."""
        self.next_ns = now_ns + self.pause_ns
