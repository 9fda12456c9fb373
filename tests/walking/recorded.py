"""Walks by the engine's own clock, and where each tick sends the servos, as a gateway passes it on: 50 times a second.

That a real gateway's frames move the robot in the same way is shown by tests/falls/test_falls.py.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from gateway.geometry import load
from gateway.people.walking import STILL, Engine, Pose, Posture, Robot, Velocity
from schemas.robot import JOINTS, LEGS, SERVO_IDS
from tests.walking.physics import Sent

HZ: Final = 50
SETTLES_S: Final = 0.2
"""Between two parts of a course: the servos have followed by then."""


class Leg(NamedTuple):
    """A part of a course: a velocity, for so long."""

    name: str
    velocity: Velocity
    seconds: float


class Walked(NamedTuple):
    """One part as it was walked: when, in seconds since the first tick."""

    part: Leg
    held_s: float
    """How long the velocity was commanded."""
    begin_s: float
    end_s: float
    """It stands."""


class Recording(NamedTuple):
    """Where the servos were sent, and which part of it was what."""

    gait: str
    sent: list[Sent]
    parts: list[Walked]


class _Ticks:
    """An engine whose clock goes on by one tick at a time."""

    def __init__(self, gait: str) -> None:
        self._engine = Engine(Robot(load()), gait)
        self.sent: list[Sent] = []
        pose = self._engine.pose
        for last in LEGS:  # one leg more at a time, as Client.walk starts them
            self._send({leg: pose[leg] for leg in LEGS if leg <= last})

    @property
    def now_s(self) -> float:
        return len(self.sent) / HZ

    def walk(self, part: Leg) -> Walked:
        begin_s = self.now_s
        for _ in range(round(part.seconds * HZ)):
            self._tick(part.velocity)
        held_s = self.now_s - begin_s
        self.stand()
        return Walked(part, held_s, begin_s, self.now_s)

    def stand(self) -> None:
        self._engine.stand()
        self._until(Posture.STANDING)

    def sit(self) -> None:
        self._engine.sit()
        self._until(Posture.SITTING)
        self.sent.append((self.now_s, dict.fromkeys(SERVO_IDS)))

    def _until(self, posture: Posture) -> None:
        self._tick()
        while self._engine.posture is not posture:
            self._tick()
        for _ in range(round(SETTLES_S * HZ)):
            self._tick()

    def _tick(self, velocity: Velocity = STILL) -> None:
        self._send(self._engine.step(velocity, 1 / HZ))

    def _send(self, pose: Pose) -> None:
        """To the hundredth of a degree, as frames have it."""
        angles = {
            10 * leg + joint: round(deg, 2)
            for leg, each in pose.items()
            for joint, deg in zip(JOINTS, each, strict=True)
        }
        self.sent.append((self.now_s, angles))


def record(gait: str, course: Sequence[Leg]) -> Recording:
    """Stand up, walk the parts with a stand between them, sit down, stop."""
    ticks = _Ticks(gait)
    ticks.stand()
    parts = [ticks.walk(part) for part in course]
    ticks.sit()
    return Recording(gait, ticks.sent, parts)


def directions(speed_m_s: float, seconds: float) -> list[Leg]:
    """Every 45 degrees: ahead, ahead to the left, left …"""
    names = ("forward", "forward left", "left", "backward left", "backward", "backward right", "right", "forward right")
    turns = [math.tau * turn / 8 for turn in range(8)]
    ways = [Velocity(speed_m_s * math.cos(turn), speed_m_s * math.sin(turn)) for turn in turns]
    return [Leg(name, way, seconds) for name, way in zip(names, ways, strict=True)]
