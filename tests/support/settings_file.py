"""Settings as `run --sim` reads them, and what it says where it cannot."""

from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.robot import settings
from gateway.robot.settings import Settings


def load(path: Path | None = None) -> Settings:
    """As for `run --sim`: nobody has to say a framing."""
    return settings.load(path, simulated=True)


def faults(path: Path | None = None) -> list[str]:
    """The lines of the ConfigError, the file's path cut off to `file`."""
    with pytest.raises(ConfigError) as raised:
        load(path)
    assert raised.value.exit_code == 2
    lines = str(raised.value).split("\n")
    assert all(line.isprintable() for line in lines), lines
    return [line.replace(str(path), "file") for line in lines]
