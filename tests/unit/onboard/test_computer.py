"""What Linux says of the computer and the SPI controller."""

import datetime as dt
from pathlib import Path

import pytest

from gateway.onboard import computer
from tests.support.machine_tree import OF_MAY, PI_4, MachineTree

SPIDEV = "/dev/spidev0.0"


def test_where_nothing_is_said_nothing_is_known(tmp_path: Path) -> None:
    assert computer.computer(tmp_path) == ""
    assert computer.kernel(tmp_path) == ("", None)
    assert computer.driver_of(SPIDEV, tmp_path) is None
    assert computer.gpio_selects(SPIDEV, tmp_path) is None
    assert computer.neighbours(SPIDEV, tmp_path) == []
    assert not computer.on_rp1(SPIDEV, tmp_path)


def test_a_controller_without_a_device_tree_says_nothing_of_chip_select(tmp_path: Path) -> None:
    tree = MachineTree(tmp_path)
    (tree.bus.parents[1] / "of_node").unlink()
    assert computer.gpio_selects(SPIDEV, tmp_path) is None


BUILT = {
    PI_4 + OF_MAY: dt.date(2024, 5, 29),
    "Linux version 6.12.25+rpt-rpi-2712 (x) (gcc) #1 SMP PREEMPT Debian 1:6.12.25-1+rpt1 (2025-04-30)\n": dt.date(
        2025, 4, 30
    ),
    "Linux version 6.6.45-v8-16k+ (a@b) (gcc (2020-01-01)) #11 SMP Sat Aug 31 13:38:16 BST 2024\n": dt.date(
        2024, 8, 31
    ),
    "Linux version 6.11.0-1008-raspi (b@c) (gcc) #8-Ubuntu SMP PREEMPT_DYNAMIC Thu Feb  6 10:11:12 UTC 2025\n": dt.date(
        2025, 2, 6
    ),
    "Linux version 6.1.0 (a@b) (gcc (2020-01-01)) #1 SMP PREEMPT\n": None,
    "Linux version 6.1.0 (a@b) #1 SMP Fri Feb 30 10:11:12 UTC 2024\n": None,
}


@pytest.mark.parametrize("version", BUILT)
def test_when_the_kernel_was_built(tmp_path: Path, version: str) -> None:
    """Not when its compiler was."""
    MachineTree(tmp_path, version=version)
    assert computer.kernel(tmp_path)[1] == BUILT[version]


def test_neighbours_are_those_of_another_driver(tmp_path: Path) -> None:
    tree = MachineTree(tmp_path)
    tree.add("spi0.2", None)
    assert computer.neighbours(SPIDEV, tmp_path) == []
    tree.add("spi0.1", "fb_st7789v")
    tree.add("spi0.3", "mcp251x")
    assert computer.neighbours(SPIDEV, tmp_path) == [("spi0.1", "fb_st7789v"), ("spi0.3", "mcp251x")]


@pytest.mark.parametrize(
    ("model", "is_one"),
    [("Raspberry Pi 5 Model B", True), ("Raspberry Pi Compute Module 5", True), ("Raspberry Pi 4 Model B", False)],
)
def test_a_pi_5_is_known_by_its_name(model: str, is_one: bool, tmp_path: Path) -> None:
    MachineTree(tmp_path, model=model)
    assert computer.is_pi_5(tmp_path) is is_one
