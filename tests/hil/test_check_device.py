"""`check` on the emulated device, and each program with spidev and without: what it says, and whom it disturbs."""

import os
from pathlib import Path

import pytest

from gateway.robot.spi.kernel import NO_SPIDEV
from tests.hil.bed import DEVICE, SpiTestbed
from tests.hil.wire import LATE_S, STOPS, Wire, settings_for
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, Gateway

pytestmark = pytest.mark.hil


@pytest.fixture(
    params=["", 'raise ImportError("built for another processor")', "class SpiDev: pass"], ids=["spidev", "none", "3.6"]
)
def env(tmp_path: Path, request: pytest.FixtureRequest) -> dict[str, str]:
    """Variables for a Python with spidev, without, or with Debian's, which has no `open_path`."""
    if not request.param:
        return {}
    folder = tmp_path / "without"
    folder.mkdir()
    (folder / "spidev.py").write_text(f"{request.param}\n")
    return {"PYTHONPATH": os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])}


def ended(bed: SpiTestbed, command: str, config: Path, env: dict[str, str]) -> Child:
    child = bed.spawn([*COMMAND, command, "--config", str(config)], env=env)
    assert child.wait(LATE_S) == 0, str(child)
    return child


def line(child: Child, name: str) -> str:
    (found,) = [line for line in child.stdout.splitlines() if line[9:].startswith(name)]
    return found


def test_run_stop_servos_and_check_with_each_spidev_and_with_none(
    tmp_path: Path, wire: Wire, env: dict[str, str]
) -> None:
    """`check` recognises a running gateway. It writes nothing, then or without one."""
    spi_testbed = wire.bed
    with Gateway(tmp_path, settings_for(wire), bed=spi_testbed, env=env) as gateway:
        opening = wire.expect_opening(*STOPS, times=2)
        assert {(each.mode, each.bits_per_word, each.speed_hz) for each in opening} == {(0, 8, 2_500_000)}
        settings = spi_testbed.settings
        beside = ended(spi_testbed, "check", gateway.config, env)
        assert "is the running gateway's" in line(beside, "SPI device")
        assert line(beside, "port").startswith("ok")
        assert "is in use by the running gateway" in line(beside, "port")
        assert spi_testbed.settings == settings
        written = wire.skip()  # the gateway writes its Stops again a second later
        assert {each.opening for each in written} <= {opening[-1].opening}
        assert {each.data for each in written} <= {each.data for each in opening}
        ended(spi_testbed, "stop-servos", gateway.config, env)
        wire.expect_opening(*STOPS)
        gateway.child.terminate()
        assert gateway.child.wait(LATE_S) == 0
    begun = len(spi_testbed.transfers)
    alone = ended(spi_testbed, "check", gateway.config, env)
    assert not alone.stderr, str(alone)
    assert line(alone, "SPI device").startswith(f"ok       SPI device     {DEVICE} opens")
    assert (NO_SPIDEV in alone.stdout) is bool(env)
    assert line(alone, "SPI speed").endswith("2.5 MHz; an emergency stop takes 1.0 ms to write")
    assert line(alone, "SPI controller").startswith("ok       SPI controller ")
    assert line(alone, "SPI bus").startswith("ok       SPI bus ")
    assert line(alone, "framing").startswith("ok")
    assert alone.stdout.splitlines()[-1].startswith("This machine can run the service")
    assert len(spi_testbed.transfers) == begun
    assert ("speed", 2_500_000) in {(setting.kind, setting.value) for setting in spi_testbed.settings}
