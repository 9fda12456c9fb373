"""`check` on an emulated robot of elkapod-2025: what it says of UART, heartbeat and answers, and what it writes."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gateway.model.elkapod import SHUTDOWN
from tests.hil.elkapod_bed import ElkapodBed
from tests.hil.test_check_device import check, line
from tests.support.gateway_process import Gateway, free_port, write_settings

pytestmark = pytest.mark.hil


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[ElkapodBed]:
    with ElkapodBed(tmp_path) as bed:
        yield bed


@pytest.fixture
def config(robot: ElkapodBed, tmp_path: Path) -> Path:
    zenoh: dict[str, Any] = {"listen": [f"tcp/127.0.0.1:{free_port()}"]}
    return write_settings(tmp_path / "gateway.toml", robot.settings_with(zenoh=zenoh, controller={"silent_ms": 500}))


def test_a_robot_that_answers_is_shut_down_before_its_answers_are_judged(robot: ElkapodBed, config: Path) -> None:
    child = check(robot, config)
    assert child.returncode == 0, str(child)
    assert line(child, "UART").startswith(f"ok       UART           {robot.uart} opens")
    assert "so the controller speaks elkapod-2025" in line(child, "heartbeat")
    assert "are well formed, with all servos shut down" in line(child, "answers")
    assert line(child, "SPI speed").endswith("a frame takes 0.6 ms to write")
    assert [each.what for each in robot.said][:5] == ["shutdown"] * 4 + [(90.0,) * 18]
    assert "start" not in {each.what for each in robot.said}


def test_without_a_heartbeat_not_a_byte_is_written(robot: ElkapodBed, config: Path) -> None:
    robot.controller.silent = True
    child = check(robot, config)
    assert child.returncode == 1, str(child)
    assert line(child, "heartbeat").startswith("failure  heartbeat")
    assert "answers" not in {row[9:].split(" ")[0] for row in child.stdout.splitlines()}
    assert robot.said == []


def test_a_running_gateway_is_not_disturbed(robot: ElkapodBed, tmp_path: Path) -> None:
    with Gateway(tmp_path, robot.settings_with(watchdog={"repeats": 0}), bed=robot) as gateway:
        # As it opens, for its first Stops, and four at rest.
        robot.wait_until(lambda: robot.messages_since(0).count(SHUTDOWN) == 6, 20)
        begun = len(robot.events)
        child = check(robot, gateway.config)
        assert child.returncode == 0, str(child)
        assert "is the running gateway's" in line(child, "UART")
        assert SHUTDOWN not in robot.messages_since(begun)
        with gateway.client() as client:
            assert client.state().controller.alive
