"""`check` on an emulated robot of elkapod-2025: what it says of UART, heartbeat and answers, and what it writes."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.hil.elkapod_bed import ElkapodBed
from tests.hil.test_check_device import check, line
from tests.support.gateway_process import free_port, write_settings

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
