"""A robot whose controller starts and stops all legs at once: programs start it whole, and any Stop ends them whole."""

from typing import Final, NoReturn

import pytest

from gateway.client import Client, Posture, RejectedError, StoppedError, Stream
from gateway.model.frames import Op, decode
from gateway.people.client.stream import WHOLE
from schemas.robot import LEGS
from schemas.telemetry import FrameRecord, Kind, Reason
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.heard import Heard, events, frames, running

LYING: Final = dict.fromkeys(LEGS, (90, 150, 110))

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


def test_a_stream_of_one_leg_is_told_what_to_send_and_one_that_leaves_a_leg_out_is_stopped_whole(
    robot: Client, watcher: Client
) -> None:
    happened = events(watcher)
    with robot.stream() as stream:
        with pytest.raises(RejectedError) as rejected:
            stream.set({1: (90, 150, 110)})
        assert rejected.value.reason == Reason.WHOLE_ROBOT
        assert rejected.value.__notes__ == [WHOLE]
        stream.start_again()
        stream.set(LYING)
        assert running(watcher) == list(LEGS)
        with pytest.raises(StoppedError) as stopped:
            leave_out(stream, leg=6)
        assert stopped.value.legs == tuple(LEGS)
    expired = happened.wait(lambda event: event.kind == Kind.WATCHDOG_EXPIRED)
    assert expired.legs == tuple(LEGS)


def leave_out(stream: Stream, leg: int) -> NoReturn:
    """Command all other legs until that ends the stream."""
    while True:
        stream.set({each: LYING[each] for each in LEGS if each != leg})
