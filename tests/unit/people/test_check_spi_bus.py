"""What `check` says of the computer, its SPI controller, and what else is on the bus."""

from pathlib import Path

import pytest

from gateway.onboard.check import spi_bus
from gateway.onboard.check.result import Verdict
from tests.support.machine_tree import PI_4, MachineTree

SPIDEV = "/dev/spidev0.0"


def pi_5(root: Path, built: str) -> None:
    MachineTree(
        root,
        driver="dw_spi_mmio",
        model="Raspberry Pi 5 Model B Rev 1.0",
        node="axi/pcie@120000/rp1/spi@50000",
        version=f"{PI_4}{built}\n",
    )


def test_computer_kernel_driver_and_chip_select_are_named(tmp_path: Path) -> None:
    MachineTree(tmp_path)
    found = spi_bus.carrier(SPIDEV, root=tmp_path)
    assert (found.verdict, found.sentence) == (
        Verdict.OK,
        "Raspberry Pi 4 Model B Rev 1.4, Linux 6.6.31+rpt-rpi-v8, driver spi-bcm2835, chip select is a GPIO",
    )


def test_a_controller_that_drives_chip_select(tmp_path: Path) -> None:
    MachineTree(tmp_path, cs_gpios=None)
    assert "the controller drives chip select" in spi_bus.carrier(SPIDEV, root=tmp_path).sentence


def test_a_computer_that_says_nothing(tmp_path: Path) -> None:
    found = spi_bus.carrier(SPIDEV, root=tmp_path)
    assert found.verdict is Verdict.OK
    assert found.sentence == "a computer without a device tree, Linux of unknown release, driver unknown"


@pytest.mark.parametrize(
    ("built", "verdict", "sentence"),
    [
        ("#1 SMP PREEMPT Debian 1:6.6.31-1+rpt1 (2024-05-29)", Verdict.WARNING, "a kernel of 2024-05-29, and before"),
        ("#1 SMP PREEMPT Debian 1:6.6.74-1 (2025-02-04)", Verdict.WARNING, "a kernel of 2025-02-04"),
        ("#1 SMP PREEMPT Debian 1:6.6.74-1 (2025-02-05)", Verdict.OK, "Raspberry Pi 5"),
        ("#1 SMP PREEMPT Wed Mar 19 11:03:01 GMT 2025", Verdict.OK, "driver dw_spi_mmio"),
        ("#1 SMP PREEMPT", Verdict.WARNING, "a kernel that was built at an unknown time"),
    ],
)
def test_an_rp1_with_a_kernel_before_the_fix(tmp_path: Path, built: str, verdict: Verdict, sentence: str) -> None:
    pi_5(tmp_path, built)
    found = spi_bus.carrier(SPIDEV, root=tmp_path)
    assert found.verdict is verdict
    assert sentence in found.sentence
    assert ("update the kernel" in found.fix) is (verdict is Verdict.WARNING)


def test_another_computer_with_an_old_kernel(tmp_path: Path) -> None:
    MachineTree(tmp_path, driver="dw_spi_mmio", model="StarFive VisionFive 2")
    assert spi_bus.carrier(SPIDEV, root=tmp_path).verdict is Verdict.OK


def test_the_second_spidev_of_a_pi_is_no_neighbour(tmp_path: Path) -> None:
    MachineTree(tmp_path)
    assert spi_bus.shared(SPIDEV, root=tmp_path).verdict is Verdict.OK


def test_a_display_on_the_same_bus_is_named(tmp_path: Path) -> None:
    tree = MachineTree(tmp_path)
    tree.add("spi0.1", "fb_st7789v")
    found = spi_bus.shared(SPIDEV, root=tmp_path)
    assert found.verdict is Verdict.WARNING
    assert found.sentence.startswith("spi0.1 (driver fb_st7789v) is on it, too: an emergency stop waits")
    assert "2 ms" in found.fix
    tree.add("spi0.2", "mcp251x")
    assert (
        "(driver fb_st7789v), spi0.2 (driver mcp251x) are on it, too" in spi_bus.shared(SPIDEV, root=tmp_path).sentence
    )
