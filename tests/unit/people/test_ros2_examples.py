"""Configurations in examples/ros2, as far as they can be read without the programs that they are for."""

from pathlib import Path
from typing import Any, Final

import pytest
from ruamel.yaml import YAML

FOLDER: Final = Path(__file__).parents[3] / "examples/ros2"
"""Priorities and seconds, as elkapod_core has them."""


@pytest.fixture(scope="module")
def mux() -> dict[str, Any]:
    found = YAML(typ="safe").load(FOLDER / "twist_mux.yaml")
    assert found.keys() == {"twist_mux"}
    parameters: dict[str, Any] = found["twist_mux"]["ros__parameters"]
    return parameters


def test_what_twist_mux_publishes_is_what_the_bridge_takes(mux: dict[str, Any]) -> None:
    """By DDS a topic has one type: cmd_vel is a Twist."""
    assert mux["use_stamped"] is False
    assert "-r cmd_vel_out:=/hexapod/cmd_vel" in (FOLDER / "twist_mux.yaml").read_text()
