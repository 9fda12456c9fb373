"""`check --stops` kills the real service under a real systemd: Stops from outside and at the new start, no motion."""

import pytest

from tests.box.installed import NAME, PYTHON, STOPS, InstalledGateway
from tests.box.test_systemd import has_started

pytestmark = [pytest.mark.systemd, pytest.mark.nightly]

CALIBRATE = """
from gateway.client import Client
from schemas.calibration import ServoChange
with Client() as robot:
    assert robot.calibrate({61: ServoChange(trim_deg=5)}).accepted
"""


def test_the_service_is_killed_and_its_stops_are_counted(robot: InstalledGateway) -> None:
    robot.unit.systemctl("start")
    robot.box.run(*PYTHON, CALIBRATE)
    before = robot.bed.transfers[-1].opening
    said = robot.gateway("check", "--stops", "--restart", "--yes", "--only", "restart", "--late", "70")
    assert "PASS     restart" in said
    assert robot.unit.properties("ActiveState", "NRestarts") == ["active", "1"]
    assert any(has_started(transfer.data) for transfer in robot.bed.transfers if transfer.opening == before)
    outside = [t.data for t in robot.bed.transfers if before < t.opening <= before + 4]  # stop-servos' four rounds
    assert len(outside) == 24
    assert set(outside) == STOPS
    assert {t.data for t in robot.bed.transfers if t.opening > before + 4} == STOPS, "and of the new start"
    shown = robot.gateway("calibrate", "export")
    robot.box.run("sh", "-c", f"rm /var/lib/{NAME}/calibration*")  # it is the service's own folder that keeps it
    assert '"revision": 1' in shown
    assert '"trim_deg": 5' in shown
