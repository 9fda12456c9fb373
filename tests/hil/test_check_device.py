"""`check` on the emulated device: what it says of it, and that it writes nothing and disturbs nobody."""

from pathlib import Path

import pytest

from tests.hil.bed import DEVICE, SpiTestbed
from tests.hil.wire import STOPS
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, Gateway, free_port, write_settings

pytestmark = pytest.mark.hil


def check(bed: SpiTestbed, config: Path) -> Child:
    child = bed.spawn([*COMMAND, "check", "--config", str(config)])
    child.wait(30)
    assert not child.stderr, str(child)
    return child


def line(child: Child, name: str) -> str:
    (found,) = [line for line in child.stdout.splitlines() if line[9:].startswith(name)]
    return found


@pytest.fixture
def config(tmp_path: Path) -> Path:
    sections: dict[str, dict[str, object]] = {
        "zenoh": {"listen": [f"tcp/127.0.0.1:{free_port()}"]},
        "spi": {"framing": "length-prefixed"},
    }
    return write_settings(tmp_path / "gateway.toml", sections)


def test_a_machine_that_can_run_it_and_not_a_byte_is_written(spi_testbed: SpiTestbed, config: Path) -> None:
    child = check(spi_testbed, config)
    assert child.returncode == 0, str(child)
    assert line(child, "SPI device").startswith(f"ok       SPI device     {DEVICE} opens")
    assert line(child, "SPI speed").endswith("2.5 MHz; an emergency stop takes 1.0 ms to write")
    assert line(child, "SPI controller").startswith("ok       SPI controller ")
    assert line(child, "SPI bus").startswith("ok       SPI bus ")
    assert line(child, "framing").startswith("ok")
    assert child.stdout.splitlines()[-1].startswith("This machine can run the service")
    assert spi_testbed.transfers == []
    assert ("speed", 2_500_000) in {(setting.kind, setting.value) for setting in spi_testbed.settings}


def test_a_running_gateway_is_recognised_and_not_disturbed(spi_testbed: SpiTestbed, tmp_path: Path) -> None:
    with Gateway(tmp_path, {}, bed=spi_testbed) as gateway:
        begun = len(spi_testbed.wait_for_count(2 * 6))
        settings = spi_testbed.settings
        child = check(spi_testbed, gateway.config)
        assert child.returncode == 0, str(child)
        assert "is held by a running gateway" in line(child, "SPI device")
        assert line(child, "port").startswith("ok")
        assert "is in use by the running gateway" in line(child, "port")
        assert spi_testbed.settings == settings
        transfers = spi_testbed.transfers[begun - 1 :]  # the gateway writes its Stops again a second later
        assert {(each.opening, each.data.hex() in STOPS) for each in transfers} == {(transfers[0].opening, True)}
