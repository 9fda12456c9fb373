"""On the emulated device: what `check` states of the driver and disturbs, with each spidev and with none."""

import os
from pathlib import Path

import pytest

from gateway.model.frames import OneServo, Op, ServoOp
from gateway.onboard.computer import SELECT_BY_GPIO
from gateway.robot.spi.kernel import NO_SPIDEV
from tests.hil.bed import DEVICE, SpiTestbed
from tests.hil.wire import LATE_S, STOPS, Replay, Wire, ended, settings_for
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, Gateway

pytestmark = pytest.mark.hil


def test_check_move_shows_that_a_driver_ignores_cs_change_and_what_to_do(
    tmp_path: Path, spi_testbed: SpiTestbed
) -> None:
    """Whoever looks on sees what a controller does that takes one frame while chip select is held."""
    wire = Wire(spi_testbed)
    spi_testbed.ignore_cs_change()
    with Gateway(tmp_path, settings_for(wire), bed=spi_testbed) as gateway:
        six_stops = b"".join(map(bytes.fromhex, STOPS))
        assert spi_testbed.wait_for_count(1)[0].data == six_stops
        child = spi_testbed.spawn([*COMMAND, "check", "--move", "--connect", gateway.endpoint])
        for answer in ("", "", "yes"):  # servo 61, at 90 degrees
            child.tell(answer)
        child.wait_for_output("All six legs were stopped at once", LATE_S)
        seen = Replay(wire.framing, selects=True).play(spi_testbed.transfers)
        assert 61 in seen.controller.energised
        child.tell("yes")
        child.tell("no")
        assert child.wait(LATE_S) == 1, str(child)
        assert SELECT_BY_GPIO in child.stdout
        left = Replay(wire.framing, selects=True).play(spi_testbed.transfers)
        assert left.controller.energised == frozenset(), "its last Stop is alone in its call"
        assert OneServo(61, ServoOp(Op.STOP)).data in [each.data for each in spi_testbed.transfers if each.delivered]


@pytest.fixture(
    params=["", 'raise ImportError("built for another processor")', "class SpiDev: pass"], ids=["spidev", "none", "3.6"]
)
def env(tmp_path: Path, request: pytest.FixtureRequest) -> dict[str, str]:
    """Return variables for a Python with spidev, without it, or with Debian's, which has no `open_path`."""
    if not request.param:
        return {}
    folder = tmp_path / "without"
    folder.mkdir()
    (folder / "spidev.py").write_text(f"{request.param}\n")
    return {"PYTHONPATH": os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])}


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
        wire.expect_nothing()
        assert {each.opening for each in wire.skip()} <= {opening[-1].opening}, "repeats of the gateway's Stops"
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
