"""A landing on the emulated device, ended by everything that can end one: each frame on the wire is looked at.

The framing is the published firmware's, and a simulated controller, which reads as it does, is given every transfer.
"""

import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from gateway.client import Client
from gateway.model.frames import Frame, Framing, Op, ServoOp, decode
from schemas.keys import servo_command
from schemas.robot import LEGS
from schemas.words import Kind, Mode, Reason
from tests.hil.bed import SpiTestbed, Transfer
from tests.hil.wire import LATE_S, Replay
from tests.support.gateway_process import Gateway
from tests.support.heard import events

pytestmark = [pytest.mark.hil, pytest.mark.alone]

TIMEOUT_MS, LANDING_MS, HZ = 1000.0, 500.0, 50.0
"""On a busy machine three starts, each answered before the next, take longer than half of this timeout."""
POSE = {31: 30.0, 32: 60.0, 33: 150.0, 41: 20.0, 42: 100.0, 51: 45.0}
STANDS = {31: 90.0, 32: 45.0, 33: 120.0, 41: 100.0, 43: 100.0}
"""What runs: servo 43 holds its angle, and 51 does not run."""
MIDWAY = 20
"""Frames: of two legs, so about 200 ms."""


class Scene:
    """A gateway with a landing pose; leg 3 and two servos of leg 4 have been started, and fall silent."""

    def __init__(self, folder: Path, bed: SpiTestbed) -> None:
        self.bed = bed
        settings: dict[str, dict[str, Any]] = {
            "spi": {"framing": Framing.LENGTH_PREFIXED},
            "limits": {"leg_rate_hz": HZ, "takeover_deg_s": 0},  # each start goes to its angle at once
            "watchdog": {"timeout_ms": TIMEOUT_MS, "landing_ms": LANDING_MS},
            "watchdog.landing": {str(servo_id): angle for servo_id, angle in POSE.items()},
        }
        self.gateway = Gateway(folder, settings, bed=bed)
        self._since = 0

    def written(self, transfers: Sequence[Transfer]) -> list[Frame]:
        """Return all frames since the servos were started."""
        return [decode(each.data) for each in transfers[self._since :] if each.delivered and len(each.data) > 1]

    def falls_silent(self, client: Client) -> None:
        """Start them, and wait for the first frame that nobody commanded."""
        self._since = len(self.bed.transfers)
        assert client.start_leg(3, 90, 45, 120).accepted
        for servo_id in (41, 43):
            ack = client.ask(servo_command(servo_id), {"op": "start", "angle_deg": 100})
            assert ack.accepted  # so soon that it waits for its rate slot
        self.wait_for_frames(1)

    def wait_for_frames(self, count: int) -> None:
        """Wait for so many of the landing, behind the three starts."""
        self.bed.wait_for(lambda found: sum(not frame.is_stop for frame in self.written(found)) >= 3 + count, LATE_S)

    def wait_for_arrival(self) -> None:
        """Wait until servo 31 is at its angle of the pose."""
        there = (31, ServoOp(Op.SET, round(100 * POSE[31])))
        self.bed.wait_for(lambda found: any(there in frame.servos for frame in self.written(found)), LATE_S)

    def check_stopped(self, *, landed: bool = False) -> None:
        """Check that each servo that runs went towards its pose, and no other moved; six Stops and their repeats
        ended it, and a controller that has read all of it energises nothing.

        `landed`: the pose was reached. That the way is straight: tests/unit/robot/test_supervisor_landing.py.
        """
        frames, angles = self.written(self.bed.transfers), dict(STANDS)
        last = max(place for place, frame in enumerate(frames) if not frame.is_stop)
        for servo_id, op in (each for frame in frames[: last + 1] for each in frame.servos if each[1].op is Op.SET):
            ends = POSE.get(servo_id, STANDS[servo_id])
            assert min(angles[servo_id], ends) <= op.angle_cdeg / 100 <= max(angles[servo_id], ends), servo_id
            angles[servo_id] = op.angle_cdeg / 100
        if landed:
            assert angles == {servo_id: POSE.get(servo_id, angle) for servo_id, angle in STANDS.items()}
        assert sum(op.op is Op.START for frame in frames for _, op in frame.servos) == len(STANDS)
        legs = [frame.servos[0][0] // 10 for frame in frames[last + 1 :]]
        assert legs[: len(LEGS)] == [*LEGS]
        assert legs == ([*LEGS] * len(legs))[: len(legs)]
        replay = Replay(Framing.LENGTH_PREFIXED).play(self.bed.transfers)
        assert replay.energised_for_good() == frozenset()
        assert not replay.controller.corruptions

    def check_next_command_must_be_a_start(self, client: Client) -> None:
        assert client.set_leg(3, 90, 45, 120, check=False).reason is Reason.SERVO_STOPPED
        assert client.start_leg(3, 90, 45, 120).accepted
        assert client.stop().accepted


@pytest.fixture
def scene(tmp_path: Path, spi_testbed: SpiTestbed) -> Scene:
    """Return a scene whose gateway the testbed ends."""
    return Scene(tmp_path, spi_testbed)


def test_only_what_runs_lands_and_it_gets_six_stops(scene: Scene) -> None:
    with scene.gateway.client() as client:
        heard = events(client)
        scene.falls_silent(client)
        heard.wait(lambda event: event.kind == Kind.WATCHDOG_EXPIRED, timeout_s=LATE_S)
        scene.check_stopped(landed=True)
        assert client.state().mode is Mode.IDLE
        scene.check_next_command_must_be_a_start(client)


def test_an_emergency_stop_ends_it_at_any_instant(scene: Scene) -> None:
    """Behind its first frame, in the middle, and when it has arrived."""
    instants: list[Callable[[], None]] = [lambda: None, lambda: scene.wait_for_frames(MIDWAY), scene.wait_for_arrival]
    with scene.gateway.client() as client:
        for instant in instants:
            scene.falls_silent(client)
            instant()
            ack = client.estop()
            assert (ack.accepted, ack.stop_frames) == (True, len(LEGS))
            scene.check_stopped()
            assert client.state().mode is Mode.ESTOPPED
            assert client.reset().accepted
            assert client.state().mode is Mode.IDLE
        scene.check_next_command_must_be_a_start(client)


def test_sigterm_in_the_middle_stops_and_lands_no_further(scene: Scene) -> None:
    with scene.gateway.client() as client:
        scene.falls_silent(client)
        scene.wait_for_frames(MIDWAY)
        scene.gateway.child.send_signal(signal.SIGTERM)
        assert scene.gateway.child.wait(LATE_S) == 0
    scene.check_stopped()
