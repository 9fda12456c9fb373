"""Without a usable package spidev the gateway's own calls do on the emulated device what those of spidev do."""

import os
from collections.abc import Mapping
from pathlib import Path

import pytest

from gateway.robot.spi import ioctls
from tests.hil.bed import DEVICE, SpiTestbed
from tests.hil.wire import LATE_S, STOPS, Wire, settings_for
from tests.support.gateway_process import COMMAND, Gateway

pytestmark = pytest.mark.hil


@pytest.fixture(params=['raise ImportError("built for another processor")', "class SpiDev: pass"], ids=["none", "3.6"])
def without(tmp_path: Path, request: pytest.FixtureRequest) -> Mapping[str, str]:
    """Variables for a Python in which `import spidev` fails, or brings Debian's, which has no `open_path`."""
    folder = tmp_path / "without"
    folder.mkdir()
    (folder / "spidev.py").write_text(f"{request.param}\n")
    return {"PYTHONPATH": os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])}


def test_check_and_stop_servos_need_no_package(
    tmp_path: Path, spi_testbed: SpiTestbed, without: Mapping[str, str]
) -> None:
    wire = Wire(spi_testbed)
    with Gateway(tmp_path, settings_for(wire), bed=spi_testbed, env=without) as gateway:
        opening = wire.expect_opening(*STOPS)
        assert {(each.mode, each.bits_per_word, each.speed_hz) for each in opening} == {(0, 8, 2_500_000)}
        gateway.child.wait_for_output(ioctls.USED)
        assert gateway.child.stderr.count(ioctls.USED) == 1
        wire.skip()
        child = spi_testbed.spawn([*COMMAND, "stop-servos", "--config", str(gateway.config)], env=without)
        assert child.wait(LATE_S) == 0, str(child)
        wire.expect_opening(*STOPS)
        gateway.child.terminate()
        assert gateway.child.wait(LATE_S) == 0
        checked = spi_testbed.spawn([*COMMAND, "check", "--config", str(gateway.config)], env=without)
        assert checked.wait(LATE_S) == 0, str(checked)
        assert f"{DEVICE} opens" in checked.stdout
        assert ioctls.USED in checked.stdout
