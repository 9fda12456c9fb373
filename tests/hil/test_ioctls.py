"""Without the package spidev: the gateway's own calls do on the emulated device what those of spidev do."""

import os
from collections.abc import Mapping
from pathlib import Path

import pytest

from gateway.robot.spi import ioctls
from schemas import keys
from tests.hil.bed import DEVICE, SpiTestbed
from tests.hil.wire import LATE_S, SET_3, START_3, STOPS, Wire, settings_for
from tests.support.gateway_process import COMMAND, Gateway

pytestmark = pytest.mark.hil


@pytest.fixture
def without(tmp_path: Path) -> Mapping[str, str]:
    """Variables for a Python in which `import spidev` fails, as on a machine that lacks it."""
    folder = tmp_path / "without"
    folder.mkdir()
    (folder / "spidev.py").write_text('raise ImportError("built for another processor")\n')
    return {"PYTHONPATH": os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])}


def scene(
    folder: Path, env: Mapping[str, str]
) -> tuple[list[str], set[tuple[str, int]], set[tuple[int, int, int]], str]:
    """A ride, a bus fault and an emergency stop: bytes, settings, what each transfer had, and what was logged.

    spidev sets no bits where the device says that it has 8 already.
    """
    folder.mkdir()
    with SpiTestbed() as bed:
        wire = Wire(bed)
        settings = settings_for(wire, watchdog={"timeout_ms": 900})
        with Gateway(folder, settings, bed=bed, env=env) as gateway, gateway.client() as client:
            wire.expect_opening(*STOPS)
            wire.expect_repeats(3, *STOPS)
            assert client.start_leg(3, 90, 45, 120).accepted
            assert client.set_leg(3, 91, 45, 120).accepted
            wire.expect(START_3, SET_3, STOPS[2])  # the last by the watchdog
            wire.expect_repeats(3, STOPS[2])
            bed.fail(count=1)
            assert client.ask(keys.ESTOP, {}).stop_frames == len(STOPS)
            gateway.child.terminate()
            assert gateway.child.wait(LATE_S) == 0
        sent = [each for each in bed.transfers if each.delivered]
        return (
            [each.data.hex() for each in sent],
            {(each.kind, each.value) for each in bed.settings if each.kind in ("mode", "speed")},
            {(each.mode, each.speed_hz, each.bits_per_word) for each in sent},
            gateway.child.stderr,
        )


def test_the_same_bytes_leave_in_the_same_way(tmp_path: Path, without: Mapping[str, str]) -> None:
    *package, said = scene(tmp_path / "package", {})
    *own, own_said = scene(tmp_path / "own", without)
    assert own == package
    assert own_said.count(ioctls.USED) == 1
    assert ioctls.USED not in said


def test_check_and_stop_servos_need_no_package(
    tmp_path: Path, spi_testbed: SpiTestbed, without: Mapping[str, str]
) -> None:
    wire = Wire(spi_testbed)
    with Gateway(tmp_path, settings_for(wire), bed=spi_testbed, env=without) as gateway:
        wire.expect_opening(*STOPS)
        child = spi_testbed.spawn([*COMMAND, "stop-servos", "--config", str(gateway.config)], env=without)
        assert child.wait(LATE_S) == 0, str(child)
        wire.expect_opening(*STOPS)
        gateway.child.terminate()
        assert gateway.child.wait(LATE_S) == 0
        checked = spi_testbed.spawn([*COMMAND, "check", "--config", str(gateway.config)], env=without)
        assert checked.wait(LATE_S) == 0, str(checked)
        assert f"{DEVICE} opens" in checked.stdout
        assert ioctls.USED in checked.stdout
