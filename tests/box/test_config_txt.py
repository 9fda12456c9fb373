"""What the installer makes of a Raspberry Pi's config.txt; that it does so is in test_installer.py."""

import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "deploy" / "config_txt.sh"


def run(function: str, text: str) -> "subprocess.CompletedProcess[str]":
    command = ["bash", "-c", f'. "{SCRIPT}"; {function}']
    return subprocess.run(command, input=text, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    "text",
    ["dtparam=spi=on\n", "dtparam=i2c_arm=on,spi=on\n", "[cm4]\notg_mode=1\n[all]\ndtparam=spi=on\n", "dtparam=spi\n"],
)
def test_where_spi_is_on(text: str) -> None:
    assert run("spi_is_on", text).returncode == 0


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("dtparam=spi=off\n", "dtparam=spi=on\n"),
        ("", "dtparam=spi=on\n"),
        ("dtoverlay=vc4-kms-v3d\n", "dtparam=spi=on\ndtoverlay=vc4-kms-v3d\n"),
        ("[cm4]\ndtparam=spi=on\n", "dtparam=spi=on\n[cm4]\ndtparam=spi=on\n"),
        ("[cm4]\n#dtparam=spi=on\n", "dtparam=spi=on\n[cm4]\n#dtparam=spi=on\n"),
    ],
)
def test_where_it_is_not_it_is_switched_on_for_every_pi(before: str, after: str) -> None:
    """Outside any filter and before any overlay."""
    assert run("spi_is_on", before).returncode == 1
    assert run("switch_spi_on", before).stdout == after
    assert run("spi_is_on", after).returncode == 0
