"""Facts about the SPI controller, from files of /proc and /sys below a root folder."""

import re
from pathlib import Path
from typing import Final

ROOT_DIR: Final = Path("/")
_GPIO_CELLS: Final = 3
"""Cells of one GPIO in `cs-gpios`: controller, pin and flags (`#gpio-cells` is 2 on each Raspberry Pi)."""


def driver_of(device: str, root: Path = ROOT_DIR) -> str | None:
    """Return the driver of the device's SPI controller, such as spi-bcm2835, or None if it is not known."""
    controller = _controller(device, root)
    return None if controller is None else bound_driver(controller)


def gpio_selects(device: str, root: Path = ROOT_DIR) -> bool | None:
    """Return whether the device's chip select is a GPIO, or None if that is not known.

    Linux drives a GPIO, and releases it between the transfers of one call. An SPI controller's own may stay asserted.
    """
    node = node_of(device, root)
    chip_select = re.fullmatch(r"spidev\d+\.(\d+)", Path(device).name)
    if node is None or chip_select is None:
        return None
    try:
        data = (node / "cs-gpios").read_bytes()
    except FileNotFoundError:
        return False
    except OSError:
        return None
    cells = [int.from_bytes(data[at : at + 4], "big") for at in range(0, len(data), 4)]
    selects = []
    while cells:
        selects.append(cells[0] != 0)  # 0: the controller's own
        del cells[: _GPIO_CELLS if cells[0] else 1]
    place = int(chip_select[1])
    return place < len(selects) and selects[place]


def spi_device(device: str, root: Path = ROOT_DIR) -> Path | None:
    """Return such as /sys/devices/platform/soc/fe204000.spi/spi_master/spi0/spi0.0."""
    return _resolved(root / "sys/class/spidev" / Path(device).name / "device")


def _controller(device: str, root: Path) -> Path | None:
    """Return such as /sys/devices/platform/soc/fe204000.spi."""
    found = spi_device(device, root)
    return found.parents[2] if found is not None and len(found.parents) > 2 else None


def node_of(device: str, root: Path = ROOT_DIR) -> Path | None:
    """Return the device tree's node of the SPI controller, or None."""
    controller = _controller(device, root)
    return None if controller is None else _resolved(controller / "of_node")


def bound_driver(device: Path) -> str | None:
    """Return the driver that is bound to a device of /sys, or None."""
    driver = _resolved(device / "driver")
    return None if driver is None else driver.name


def _resolved(path: Path) -> Path | None:
    try:
        return path.resolve(strict=True)
    except (OSError, RuntimeError):
        return None
