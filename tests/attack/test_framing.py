"""Nobody has said which framing the controller needs: two plain frames would jam the published firmware for good."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.support.gateway_process import COMMAND


@pytest.mark.parametrize("command", ["run", "stop-servos", "check"])
def test_no_device_is_touched_before_somebody_has_said_the_framing(tmp_path: Path, command: str) -> None:
    device = tmp_path / "spidev0.0"  # as good as any to be opened and written to
    device.touch()
    config = tmp_path / "gateway.toml"
    config.write_text(f'[spi]\ndevice = "{device}"\n')
    env = {name: value for name, value in os.environ.items() if name != "HEXAPOD_SPI__FRAMING"}
    end = subprocess.run(
        [*COMMAND, command, "--config", str(config)], capture_output=True, text=True, check=False, timeout=30, env=env
    )
    assert end.returncode == 2
    unset, document, published = end.stderr.splitlines()
    assert "spi.framing: is not set" in unset
    assert 'published STM32 firmware needs "length-prefixed"' in published
    assert 'protocol document needs "plain"' in document
    assert end.stdout == ""
    assert device.stat().st_size == 0
