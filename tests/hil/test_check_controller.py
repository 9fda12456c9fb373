"""`check` on an emulated robot of elkapod-2025: what it says of UART and heartbeat, and that it writes nothing."""

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


def test_its_heartbeat_is_heard_and_nothing_is_written(robot: ElkapodBed, config: Path) -> None:
    child = check(robot, config)
    assert child.returncode == 0, str(child)
    assert line(child, "UART").startswith(f"ok       UART           {robot.uart} opens")
    assert "so the controller speaks elkapod-2025" in line(child, "heartbeat")
    assert line(child, "SPI speed").endswith("a frame takes 0.6 ms to write")
    assert robot.said == []
