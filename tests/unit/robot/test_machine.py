"""What Linux says of the computer and the SPI controller."""

import datetime as dt
import struct
from pathlib import Path

import pytest

from gateway.robot.spi import machine
from tests.support.machine_tree import GPIOS, OF_MAY, PI_4, MachineTree

SPIDEV = "/dev/spidev0.0"


def test_a_raspberry_pi(tmp_path: Path) -> None:
    MachineTree(tmp_path)
    assert machine.computer(tmp_path) == "Raspberry Pi 4 Model B Rev 1.4"
    assert machine.kernel(tmp_path) == ("6.6.31+rpt-rpi-v8", dt.date(2024, 5, 29))
    assert machine.driver_of(SPIDEV, tmp_path) == "spi-bcm2835"
    assert machine.gpio_selects(SPIDEV, tmp_path) is True
    assert machine.neighbours(SPIDEV, tmp_path) == []
    assert not machine.on_rp1(SPIDEV, tmp_path)


def test_where_nothing_is_said_nothing_is_known(tmp_path: Path) -> None:
    assert machine.computer(tmp_path) == ""
    assert machine.kernel(tmp_path) == ("", None)
    assert machine.driver_of(SPIDEV, tmp_path) is None
    assert machine.gpio_selects(SPIDEV, tmp_path) is None
    assert machine.neighbours(SPIDEV, tmp_path) == []
    assert not machine.on_rp1(SPIDEV, tmp_path)


@pytest.mark.parametrize("device", ["/dev/spidev3.0", "/dev/null", "/dev/hexapod"])
def test_another_device_has_no_controller(tmp_path: Path, device: str) -> None:
    MachineTree(tmp_path)
    assert (machine.driver_of(device, tmp_path), machine.gpio_selects(device, tmp_path)) == (None, None)


@pytest.mark.parametrize(
    ("chip_select", "cells", "expected"),
    [
        (0, None, False),
        (0, b"", False),
        (0, GPIOS, True),
        (1, GPIOS, True),
        (2, GPIOS, False),
        (0, struct.pack(">4I", 0, 7, 8, 1), False),
        (1, struct.pack(">4I", 0, 7, 8, 1), True),
        (1, struct.pack(">4I", 7, 8, 1, 0), False),
        (1, struct.pack(">5I", 0, 0, 7, 8, 1), False),
        (2, struct.pack(">5I", 0, 0, 7, 8, 1), True),
    ],
)
def test_cs_gpios_decides_for_each_chip_select(
    tmp_path: Path, chip_select: int, cells: bytes | None, expected: bool
) -> None:
    """An entry of 0 is the controller's own, and so is one behind the last."""
    tree = MachineTree(tmp_path, cs_gpios=cells)
    device = tmp_path / f"sys/class/spidev/spidev0.{chip_select}"
    device.mkdir(exist_ok=True)
    if chip_select:
        (device / "device").symlink_to(tree.add(f"spi0.{chip_select}", "spidev"))
    assert machine.gpio_selects(f"/dev/spidev0.{chip_select}", tmp_path) is expected


def test_a_controller_without_a_device_tree_says_nothing_of_chip_select(tmp_path: Path) -> None:
    tree = MachineTree(tmp_path)
    (tree.bus.parents[1] / "of_node").unlink()
    assert machine.gpio_selects(SPIDEV, tmp_path) is None


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
    "Linux version 6.1.0 (a@b) #1 SMP (2024-13-45)\n": None,
    "Linux version 6.1.0 (a@b) #1 SMP Fri Feb 30 10:11:12 UTC 2024\n": None,
}


@pytest.mark.parametrize("version", BUILT)
def test_when_the_kernel_was_built(tmp_path: Path, version: str) -> None:
    """Not when its compiler was."""
    MachineTree(tmp_path, version=version)
    assert machine.kernel(tmp_path)[1] == BUILT[version]


@pytest.mark.parametrize(
    ("driver", "model", "node", "expected"),
    [
        ("dw_spi_mmio", "Raspberry Pi 5 Model B Rev 1.0", "axi/pcie@120000/rp1/spi@50000", True),
        ("dw_spi_mmio", "Another computer with an RP1", "axi/pcie@120000/rp1/spi@50000", True),
        ("spi-dw-mmio", "Raspberry Pi Compute Module 5 Rev 1.0", "soc/spi@50000", True),
        ("dw_spi_mmio", "StarFive VisionFive 2", "soc/spi@50000", False),
        ("spi-bcm2835", "Raspberry Pi 5 Model B Rev 1.0", "axi/pcie@120000/rp1/spi@50000", False),
    ],
)
def test_the_rp1_is_known_by_driver_and_device_tree(
    tmp_path: Path, driver: str, model: str, node: str, expected: bool
) -> None:
    MachineTree(tmp_path, driver=driver, model=model, node=node)
    assert machine.on_rp1(SPIDEV, tmp_path) is expected


def test_neighbours_are_those_of_another_driver(tmp_path: Path) -> None:
    tree = MachineTree(tmp_path)
    tree.add("spi0.2", None)
    assert machine.neighbours(SPIDEV, tmp_path) == []
    tree.add("spi0.1", "fb_st7789v")
    tree.add("spi0.3", "mcp251x")
    assert machine.neighbours(SPIDEV, tmp_path) == [("spi0.1", "fb_st7789v"), ("spi0.3", "mcp251x")]
