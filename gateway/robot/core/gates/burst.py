"""A start without `sent_ms` waits until `core/backlog.py` has judged the rhythm of its messages. Pure."""

from gateway.robot.core.servo import WAITING, Servo


class BurstGate:
    """When each waiting start is judged."""

    def __init__(self) -> None:
        self.judged_ns: dict[int, int] = {}
        """By servo; a released start is not in it."""

    def opens_ns(self, servo: Servo) -> int:  # mutants accepted (Step): long ago
        return self.judged_ns.get(servo.servo_id, 0)

    def holds(self, servo: Servo) -> bool:
        """Return whether this servo's start waits to be judged."""
        return servo.servo_id in self.judged_ns and servo.life is WAITING
