"""Walking through a real gateway: what it sends, and how a walk ends."""

import math
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import pytest

from gateway.client import Client, Walk
from gateway.errors import LeaseError, LeaseLostError, RejectedError, StoppedError, WalkError
from gateway.geometry import load
from gateway.model.frames import Op, decode
from gateway.people.walking import LONGEST_S, Engine, Posture, Robot
from schemas.calibration import ServoChange
from schemas.robot import JOINTS, LEGS
from schemas.telemetry import Ack, FrameRecord, GatewayState, Mode, Reason
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.gateway_process import Gateway
from tests.support.heard import frames, running, states

PATIENT: Final = patient(10_000, telemetry={"frames": True})
WALKS_S: Final = 60.0
QUICKER: Final = 4
"""Ticks are 80 ms of a walk's time then, and a tick may be 100 (gateway/people/walking/engine.py)."""


gateway = gateway_fixture(PATIENT)


watcher = client_fixture("watcher", rests=True)
robot = client_fixture("walker")


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """A walk's own clock is quicker than the gateway's: as many ticks a second, and each goes further.

    Its patience with its program stays the same, for a machine that is busy.
    """
    quick = SimpleNamespace(monotonic=lambda: QUICKER * time.monotonic())
    monkeypatch.setattr("gateway.people.client.walk.time", quick)


def once(watcher: Client, holds: Callable[[GatewayState], bool]) -> None:
    """Wait for a published state for which it holds."""
    states(watcher).wait(holds, timeout_s=WALKS_S)


def is_now(walk: Walk, posture: Posture) -> bool:
    return walk.state.posture is posture


def walks(walk: Walk, steps: int = 15, forward_m_s: float = 0.1) -> None:
    for _ in range(steps):
        walk.go(forward_m_s=forward_m_s)


def angles(records: list[FrameRecord]) -> Iterator[tuple[int, int]]:
    """Servo and angle in hundredths of a degree, as written."""
    for record in records:
        for servo_id, op in decode(bytes.fromhex(record.bytes)).servos:
            if op.op is not Op.STOP:
                yield servo_id, op.angle_cdeg


def test_a_dozen_lines_stand_walk_turn_and_sit(robot: Client, watcher: Client) -> None:
    written = frames(watcher)
    before = watcher.state().commands
    with robot.walk() as walk:
        assert is_now(walk, Posture.LYING)
        assert not running(watcher)
        assert watcher.state().lease.holder == "walker"
        walk.stand(height_m=0.14)
        assert running(watcher) == [1, 2, 3, 4, 5, 6]
        assert is_now(walk, Posture.STANDING)
        assert walk.state.height_m == pytest.approx(0.14)
        for _ in range(30):
            walk.go(forward_m_s=0.07, turn_rad_s=0.15)
        state = walk.state
        assert state.posture is Posture.WALKING
        assert state.commanded == state.scaled == (0.07, 0.0, 0.15)
        assert 0.06 < state.odometry.x_m < 0.17
        assert 0.1 < state.odometry.heading_rad < 0.36
        walk.sit()
        assert is_now(walk, Posture.SITTING)
    after = watcher.state()
    assert after.mode == Mode.IDLE
    assert after.lease.holder is None
    assert after.commands.rejected == before.rejected
    servos = list(dict.fromkeys(servo for servo, _ in angles(written.all)))
    assert servos == [10 * leg + joint for leg in LEGS for joint in JOINTS], "leg after leg"
    with pytest.raises(RuntimeError, match="over after it"):
        walk.go(0.1)


def test_so_far_ahead_and_so_far_round_and_odometry_goes_on_after_an_error(robot: Client, watcher: Client) -> None:
    with robot.walk() as walk:
        walk.ahead(0.1)
        assert is_now(walk, Posture.STANDING)
        assert walk.state.odometry.x_m == pytest.approx(0.1, abs=0.03)
        walk.turn(-0.2)
        there = walk.state.odometry
        assert there.heading_rad == pytest.approx(-0.2, abs=0.1)
        number = watcher.estop().estop
        with pytest.raises(StoppedError, match="emergency stop"):
            walk.ahead(-10)
        assert robot.reset(number).accepted
        walk.start_again()
        assert (walk.state.posture, walk.state.odometry) == (Posture.LYING, there)
        walk.ahead(-0.1)
        assert math.hypot(*walk.state.odometry[:2]) < 0.06
        with pytest.raises(WalkError, match="are these degrees"):
            walk.turn(90)


def test_a_start_that_is_rejected_as_late_ends_the_walk(
    robot: Client, watcher: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a busy machine. The stream sends nothing after it, so the walk must not count itself as standing."""
    asked = robot.ask

    def late(key: str, payload: Mapping[str, Any], **options: Any) -> Ack:
        if any(servo["op"] == "start" for servo in payload.get("legs", {}).get("3", {}).get("servos", ())):
            return Ack(accepted=False, reason=Reason.STALE, detail="published 300 ms ago")
        return asked(key, payload, **options)

    monkeypatch.setattr(robot, "ask", late)
    begun_s = time.monotonic()
    with pytest.raises(RejectedError, match="300 ms ago"), robot.walk() as walk:
        walk.stand()
    assert time.monotonic() - begun_s < LONGEST_S / 2
    assert watcher.state().mode == Mode.IDLE


def test_after_stops_of_others_it_goes_on_as_the_robot_then_is_and_an_error_of_the_program_stops_it(
    robot: Client, watcher: Client
) -> None:
    """What follows from which Stop: tests/unit/people/test_ride_again.py. Here the thread asks, starts and ends."""

    def program(walk: Walk) -> None:
        walk.stand()
        walks(walk, 10)
        assert watcher.stop(3).accepted
        with pytest.raises(StoppedError, match="somebody else stopped leg 3") as error:
            walks(walk, 500)
        assert error.value.legs == (3,)
        assert running(watcher) == [1, 2, 4, 5, 6]
        assert (is_now(walk, Posture.HALTED), walk.state.lost) == (True, (3,))
        assert walk.now == "Leg 3 is stopped, and the others stand still"
        walk.start_again()
        walk.stand()
        assert running(watcher) == [1, 2, 3, 4, 5, 6]
        with watcher.lease(take=True):
            with pytest.raises(LeaseLostError, match="watcher"):
                walks(walk, 500)
            with pytest.raises(LeaseError, match="held by watcher"):
                walk.start_again()
            with pytest.raises(LeaseLostError, match="watcher"):
                walk.stand()
            assert not running(watcher)
        walk.start_again()
        assert not running(watcher)
        assert is_now(walk, Posture.LYING)
        walk.stand()
        assert watcher.state().lease.holder == "walker"
        raise ZeroDivisionError

    def leaves() -> None:
        with robot.walk() as walk:
            program(walk)

    with pytest.raises(ZeroDivisionError):
        leaves()
    assert watcher.state().mode == Mode.IDLE
    assert watcher.state().lease.holder is None


def test_after_a_lost_leg_and_an_emergency_stop_all_six_start_one_after_the_other_from_lying(
    robot: Client, watcher: Client
) -> None:
    with robot.walk() as walk:
        walk.stand()
        walks(walk, 10)
        assert watcher.stop(3).accepted
        with pytest.raises(StoppedError, match="somebody else stopped leg 3"):
            walks(walk, 500)
        number = watcher.estop().estop
        states(watcher).wait(lambda _: walk.state.lost == (1, 2, 3, 4, 5, 6))
        states(watcher).wait(lambda _: walk.now == "Emergency stop by watcher: nothing runs until a reset")
        assert robot.reset(number).accepted
        states(watcher).wait(lambda _: walk.now == "All six legs are stopped, and hold no weight")
        with pytest.raises(StoppedError) as error:
            walk.stand()
        assert str(error.value) == "watcher engaged the emergency stop"
        walk.start_again()
        assert (is_now(walk, Posture.LYING), running(watcher)) == (True, [])
        written = frames(watcher)
        walk.stand()
        servos = list(dict.fromkeys(servo for servo, _ in angles(written.all)))
        assert servos == [10 * leg + joint for leg in LEGS for joint in JOINTS], "leg after leg"
        first = dict(reversed(list(angles(written.all))))
        lying = Engine(Robot(load())).pose
        assert [first[servo] / 100 for servo in servos] == pytest.approx(
            [angle for leg in LEGS for angle in lying[leg]], abs=0.02
        )


def test_no_leg_is_said_to_be_stopped_that_has_just_been_started(robot: Client, watcher: Client) -> None:
    """The newest report may be older than a start; its answer is not."""
    written, said = frames(watcher), []
    with robot.walk() as walk:
        walk.stand(wait=False)
        for _ in written.each():
            said.append(walk.now)
            if said[-1] == "It stands":
                break
    assert "It moves to another posture" in said
    assert not [sentence for sentence in said if "stopped" in sentence]


def test_two_walkers_are_one_too_many(robot: Client, watcher: Client) -> None:
    with robot.walk():
        with pytest.raises(LeaseError, match="held by walker"), watcher.walk():
            pass
        with pytest.raises(RuntimeError, match="walks already"):
            robot.walk().open()
    with robot.lease(), robot.walk():
        pass
    with robot.walk():
        pass


def test_what_it_cannot_do_is_reported_before_anything_moves(robot: Client, watcher: Client) -> None:
    before = watcher.state().commands
    with pytest.raises(WalkError, match="there is no gait"):
        robot.walk(gait="gallop")
    with pytest.raises(ValueError, match="0 Hz; a stream's rate"):
        robot.walk(hz=0)
    with robot.walk() as walk:
        with pytest.raises(WalkError, match=r"it cannot stand 0\.5 m high: leg 1 does not reach"):
            walk.stand(height_m=0.5)
        with pytest.raises(WalkError, match="a velocity is a finite number"):
            walk.go(forward_m_s=float("nan"))
        with pytest.raises(ValueError, match="a time above 0"):
            walk.hold_s = 0
        with pytest.raises(WalkError, match="there is no gait"):
            walk.walk_as("gallop")
    assert watcher.state().commands == before


def test_settings_and_calibration_are_kept(tmp_path: Path) -> None:
    """No command is rejected, and no servo goes faster or further than it may; a change between two walks counts."""
    slow = {"min_deg": 70, "max_deg": 110, "max_speed_deg_s": 120}
    servos = {f"limits.servos.{leg}1": slow for leg in range(1, 7)}
    with (
        Gateway(tmp_path, {**PATIENT, "limits": {"leg_rate_hz": 40}, **servos}) as gateway,
        gateway.client(source="walker") as robot,
    ):
        assert robot.calibrate({11: ServoChange(min_deg=80)}).accepted
        written = frames(robot)
        with robot.walk() as walk:
            walk.rest_s = 1.0
            walk.stand()
            walks(walk, 20, forward_m_s=0.3)
            assert "the legs' strides reach" in walk.state.limit
            once(robot, lambda state: state.mode == Mode.IDLE)  # by its own rest
            assert is_now(walk, Posture.SITTING)
            assert robot.calibrate({21: ServoChange(max_deg=100)}).accepted
            with pytest.raises(WalkError, match="the calibration has changed"):
                walk.stand()
            walk.start_again()
            walk.stand()
        assert robot.state().commands.rejected == 0
        mirrored = {10 * leg + 2: ServoChange(inverted=True) for leg in (2, 4, 6)}
        assert robot.calibrate(mirrored).accepted
        with pytest.raises(WalkError, match="turned round by the calibration, and by the geometry"), robot.walk():
            pass
        assert robot.state().lease.holder is None
        seen = {servo: [a for s, a in angles(written.all) if s == servo] for servo in (11, 21, 31)}
        assert min(seen[11]) >= 80_00
        assert min(seen[31]) >= 70_00
        assert max(seen[31]) <= 110_00
