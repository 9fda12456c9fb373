"""Facts about the computer, its kernel and its SPI bus, for `check` and `setup`, from files of /proc and /sys."""

import datetime as dt
import re
from contextlib import suppress
from pathlib import Path
from typing import Final

ROOT_DIR: Final = Path("/")
SELECT_BY_GPIO: Final = "let a GPIO select the controller (cs-gpios in the device tree, as on a Raspberry Pi)"
RP1_FIXED: Final = dt.date(2025, 2, 5)
"""Before this date, Linux for a Pi 5's RP1 lost clock edges of transfers that only send (raspberrypi/linux 6285, 6286;
fixed by 6646 and 6649). A kernel built earlier lacks the fix. No version shows which later kernels have it."""
_GPIO_CELLS: Final = 3
"""Cells of one GPIO in `cs-gpios`: controller, pin and flags (`#gpio-cells` is 2 on each Raspberry Pi)."""
_RP1_DRIVERS: Final = ("dw_spi_mmio", "spi-dw-mmio")
_MONTHS: Final = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")


def driver_of(device: str, root: Path = ROOT_DIR) -> str | None:
    """Return the driver of the device's SPI controller, such as spi-bcm2835, or None if it is not known."""
    return _bound(_spi_device(device, root).parents[2])


def gpio_selects(device: str, root: Path = ROOT_DIR) -> bool | None:
    """Return whether the device's chip select is a GPIO, or None if that is not known.

    Linux drives a GPIO, and releases it between the transfers of one call. An SPI controller's own may stay asserted.
    """
    node = _node_of(device, root)
    chip_select = re.fullmatch(r"spidev\d+\.(\d+)", Path(device).name)
    if chip_select is None or not node.exists():
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


def on_rp1(device: str, root: Path = ROOT_DIR) -> bool:
    """Return whether the SPI controller is in the RP1, a Pi 5's I/O chip."""
    named = any(part.startswith("rp1") for part in _node_of(device, root).parts)
    return (named or computer(root).startswith("Raspberry Pi")) and driver_of(device, root) in _RP1_DRIVERS


def neighbours(device: str, root: Path = ROOT_DIR) -> list[tuple[str, str]]:
    """Return the other devices on the device's bus, with their drivers: ("spi0.1", "fb_st7789v").

    Devices without a driver are left out, and those with the device's own (spidev), which programs may use.
    """
    own = _spi_device(device, root)
    found = [(each.name, _bound(each)) for each in sorted(own.parent.glob(f"{own.parent.name}.*"))]
    return [(name, driver) for name, driver in found if driver is not None and driver != _bound(own)]


def _spi_device(device: str, root: Path) -> Path:
    """Return such as /sys/devices/platform/soc/fe204000.spi/spi_master/spi0/spi0.0; no such path if it is not known."""
    return (root / "sys/class/spidev" / Path(device).name / "device").resolve()


def _node_of(device: str, root: Path) -> Path:
    """Return the device tree's node of the SPI controller; no such path if it is not known."""
    return (_spi_device(device, root).parents[2] / "of_node").resolve()


def _bound(device: Path) -> str | None:
    """Return the driver that is bound to a device of /sys."""
    driver = device / "driver"
    return driver.resolve().name if driver.exists() else None


def computer(root: Path = ROOT_DIR) -> str:
    """Return the computer's name, such as `Raspberry Pi 4 Model B Rev 1.4`, or "" without a device tree."""
    try:
        return (root / "proc/device-tree/model").read_text(errors="replace").rstrip("\0\n")
    except OSError:
        return ""


def is_pi_5(root: Path = ROOT_DIR) -> bool:
    """Return whether the computer is a Raspberry Pi 5 or its Compute Module."""
    return computer(root).startswith(("Raspberry Pi 5", "Raspberry Pi Compute Module 5"))


def kernel(root: Path = ROOT_DIR) -> tuple[str, dt.date | None]:
    """Return the kernel's release (`6.6.31+rpt-rpi-v8`), and its build date, if known."""
    try:
        text = (root / "proc/version").read_text(errors="replace")
    except OSError:
        return "", None
    release = re.match(r"Linux version (\S+)", text)
    return release[1] if release else "", _built(text.rpartition(" #")[2])


def _built(version: str) -> dt.date | None:
    """The date in `1 SMP PREEMPT Debian 1:6.6.31-1+rpt1 (2024-05-29)` or `1 SMP Sat Aug 31 13:38:16 BST 2024`."""
    with suppress(ValueError):
        if found := re.search(r"\((\d{4}-\d\d-\d\d)\)", version):
            return dt.date.fromisoformat(found[1])
        if found := re.search(rf"\b({'|'.join(_MONTHS)}) +(\d+) [\d:]+ \S+ (\d{{4}})\b", version):
            return dt.date(int(found[3]), 1 + _MONTHS.index(found[1]), int(found[2]))
    return None
