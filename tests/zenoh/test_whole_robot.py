"""A robot whose controller starts and stops all legs at once: programs start it whole, and any Stop ends them whole."""

import pytest

from gateway.client import Client, Posture, StoppedError
from gateway.model.frames import Op, decode
from schemas.robot import LEGS
from schemas.telemetry import FrameRecord
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.heard import Heard, frames, running

gateway = gateway_fixture(patient(spi={"protocol": "elkapod-2025"}, telemetry={"frames": True}))
robot = client_fixture("a program", rests=True)
watcher = client_fixture("somebody else", rests=True)


def starts(written: Heard[FrameRecord]) -> list[int]:
    """The legs of the frames that start servos, in their order."""
    found = [decode(bytes.fromhex(record.bytes)) for record in written.all]
    return [frame.leg for frame in found if any(command.op is Op.START for _, command in frame.servos)]


def test_a_walk_starts_all_legs_at_once_and_goes_on_from_lying_after_a_stop_of_one(
    robot: Client, watcher: Client
) -> None:
    written = frames(watcher)
    with robot.walk() as walk:
        walk.stand()
        assert starts(written) == list(LEGS)
        assert watcher.stop(3).accepted
        assert running(watcher) == []
        with pytest.raises(StoppedError) as stopped:
            walk.stand(height_m=0.12)
        assert stopped.value.legs == tuple(LEGS)
        halted = walk.state.posture
        assert halted is Posture.HALTED
        walk.start_again()
        walk.stand()
        assert starts(written) == 2 * list(LEGS)
        assert walk.state.posture is Posture.STANDING
