"""The service unit under a real systemd: it starts, is watched, is stopped from outside after every end, gives up."""

import subprocess
from pathlib import Path

import pytest

from gateway.protocol.frames import Op, OneLeg, decode
from tests.box.robot import DROP_IN, NAME, REPOSITORY, STOPS, Robot
from tests.child import Child

pytestmark = pytest.mark.systemd

UNIT = REPOSITORY / "deploy/systemd/hexapod-gateway.service"
MOVE_LEG_3 = ("send", "leg", "3", "start", "90", "45", "120")


def has_started(data: bytes) -> bool:
    """Whether the frame energises a servo."""
    return any(command.op is Op.START for _, command in decode(data).servos)


def wait_for_start(robot: Robot, since: int) -> None:
    """Wait for a frame that energises a servo."""
    robot.bed.wait_for(lambda seen: any(has_started(transfer.data) for transfer in seen[since:]))


def test_exposure() -> None:
    """At most 2.0, as `systemd-analyze security` counts it."""
    command = ["systemd-analyze", "security", "--offline=true", "--no-pager", "--threshold=20", str(UNIT)]
    analysed = subprocess.run(command, capture_output=True, text=True, check=False)
    assert analysed.returncode == 0, analysed.stdout


def test_start_command_stop(robot: Robot) -> None:
    """`systemctl start` returns once commands are taken; a command moves; `systemctl stop` ends in Stops, twice over."""
    before = len(robot.bed.transfers)
    robot.unit.systemctl("start")
    assert {transfer.data for transfer in robot.bed.transfers[before:]} == STOPS
    assert robot.unit.properties("ActiveState", "SubState", "NRestarts") == ["active", "running", "0"]

    assert "accepted" in robot.gateway(*MOVE_LEG_3)
    moved = len(robot.bed.transfers)
    robot.unit.systemctl("stop")
    openings = [transfer.opening for transfer in robot.bed.transfers[moved:]]
    after = [transfer for transfer in robot.bed.transfers[moved:] if transfer.opening == max(openings)]
    assert {transfer.data for transfer in after} == STOPS, "stop-servos ran, with an opening of its own"
    own = {transfer.data for transfer in robot.bed.transfers[moved:] if transfer.opening != max(openings)}
    assert own == STOPS, "the service itself stopped all legs first"
    assert robot.unit.properties("ActiveState", "Result", "ExecMainStatus") == ["inactive", "success", "0"]
