"""Walks through a real gateway with a simulated controller, and the frames that it wrote.

`record` is in lockstep: a walker's tick goes to the gateway, the gateway writes its six frames, and only then comes the
next tick. Each frame counts at the time of the tick that it came from. So a recording is the same on a machine that is
busy, takes less time than the walk, and what a judge finds in it is a fault of the gait and not of the machine.
"""

import math
import queue
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from gateway.client import Client, Stream
from gateway.geometry import load
from gateway.people.walking import STILL, Engine, Odometry, Pose, Posture, Robot, Velocity
from gateway.people.walking.robot import ranges
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Cause, FrameRecord
from tests.support.gateway_process import Gateway

HZ: Final = 50
SETTLES_S: Final = 0.2
"""Between two parts of a course: the servos have followed by then."""
_STREAM_HZ: Final = 1000
"""No tick waits for its time: the frames do."""
_WRITTEN_WITHIN_S: Final = 20.0
_PATIENT: Final[dict[str, dict[str, Any]]] = {
    "telemetry": {"frames": True},
    "limits": {"leg_rate_hz": 1000},
    "watchdog": {"timeout_ms": 10_000},  # it outlasts a moment in which this machine is busy
    "lease": {"ttl_ms": 10_000},
}


class Leg(NamedTuple):
    """A part of a course: a velocity, for so long."""

    name: str
    velocity: Velocity
    seconds: float


class Walked(NamedTuple):
    """One part as it was walked: when, in seconds since the first frame, and how far by its own reckoning."""

    part: Leg
    held_s: float
    """How long the velocity was commanded."""
    begin_s: float
    end_s: float
    """It stands."""
    begin: Odometry
    end: Odometry


class Recording(NamedTuple):
    """What a gateway wrote, and which part of it was what."""

    gait: str
    records: list[FrameRecord]
    parts: list[Walked]


class _Written:
    """The frames that a gateway writes after its start, as they come."""

    def __init__(self, client: Client) -> None:
        self._records: queue.SimpleQueue[FrameRecord] = queue.SimpleQueue()
        self._subscriber: Any = client.session.declare_subscriber(
            keys.FRAME, lambda sample: self._put(FrameRecord.model_validate_json(sample.payload.to_bytes()))
        )
        client.state()  # the gateway has answered, so it knows of the subscription

    def _put(self, record: FrameRecord) -> None:
        if record.cause not in (Cause.STARTUP, Cause.REPEAT):  # its Stops may be published after it is ready
            self._records.put(record)

    def take(self, count: int) -> list[FrameRecord]:
        """The next ones. Raises TimeoutError."""
        taken: list[FrameRecord] = []
        try:
            while len(taken) < count:
                taken.append(self._records.get(timeout=_WRITTEN_WITHIN_S))
        except queue.Empty:
            raise TimeoutError(f"the gateway wrote {len(taken)} of {count} frames in {_WRITTEN_WITHIN_S} s") from None
        return taken


class _Lockstep:
    """An engine whose clock stands still until the gateway has written what it wanted."""

    def __init__(self, engine: Engine, stream: Stream, written: _Written) -> None:
        self._engine, self._stream, self._written = engine, stream, written
        self._ticks = 0
        self.records: list[FrameRecord] = []
        pose = engine.pose
        for last in LEGS:  # one leg more at a time, as Client.walk starts them
            self._set({leg: pose[leg] for leg in LEGS if leg <= last})

    @property
    def now_s(self) -> float:
        return self._ticks / HZ

    def walk(self, part: Leg) -> Walked:
        begin, begin_s = self._engine.odometry, self.now_s
        for _ in range(round(part.seconds * HZ)):
            self._tick(part.velocity)
        held_s = self.now_s - begin_s
        self.stand()
        return Walked(part, held_s, begin_s, self.now_s, begin, self._engine.odometry)

    def stand(self) -> None:
        self._engine.stand()
        self._until(Posture.STANDING)

    def sit(self) -> None:
        self._engine.sit()
        self._until(Posture.SITTING)

    def stops(self) -> None:
        """The end of the stream has written these."""
        self._keep(self._written.take(len(LEGS)))

    def _until(self, posture: Posture) -> None:
        self._tick()
        while self._engine.posture is not posture:
            self._tick()
        for _ in range(round(SETTLES_S * HZ)):
            self._tick()

    def _tick(self, velocity: Velocity = STILL) -> None:
        self._set(self._engine.step(velocity, 1 / HZ))

    def _set(self, pose: Pose) -> None:
        self._stream.set(pose)
        self._keep(self._written.take(len(pose)))
        self._ticks += 1

    def _keep(self, records: Sequence[FrameRecord]) -> None:
        now_ns = round(self.now_s * 1e9)
        self.records += [record.model_copy(update={"monotonic_ns": now_ns}) for record in records]


def record(folder: Path, gait: str, course: Sequence[Leg]) -> Recording:
    """Stand up, walk the parts with a stand between them, sit down, stop: in lockstep, through its own gateway."""
    with Gateway(folder, _PATIENT) as gateway, gateway.client(source="watcher") as watcher:
        written = _Written(watcher)
        with gateway.client(source="walker") as client, client.lease():
            engine = Engine(Robot(load(), ranges(client.state().limits, client.calibration())), gait)
            with client.stream(_STREAM_HZ) as stream:
                lockstep = _Lockstep(engine, stream, written)
                lockstep.stand()
                parts = [lockstep.walk(part) for part in course]
                lockstep.sit()
            lockstep.stops()
        return Recording(gait, lockstep.records, parts)


def directions(speed_m_s: float, seconds: float) -> list[Leg]:
    """Every 45 degrees: ahead, ahead to the left, left …"""
    names = ("forward", "forward left", "left", "backward left", "backward", "backward right", "right", "forward right")
    return [
        Leg(
            name,
            Velocity(speed_m_s * math.cos(math.tau * turn / 8), speed_m_s * math.sin(math.tau * turn / 8)),
            seconds,
        )
        for turn, name in enumerate(names)
    ]
