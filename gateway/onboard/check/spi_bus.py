"""The computer and its SPI controller: what carries the frames, and what else is on the bus."""

from pathlib import Path
from typing import Final

from gateway.onboard.check.result import Result, ok, warning
from gateway.robot.spi.machine import (
    ROOT_DIR,
    RP1_FIXED,
    computer,
    driver_of,
    gpio_selects,
    kernel,
    neighbours,
    on_rp1,
)

_LONGEST_MS: Final = 2
"""What a neighbour's transfer may take (docs/safety.md): an emergency stop waits for two to four of them."""


def carrier(device: str, *, root: Path = ROOT_DIR) -> Result:
    """Computer, kernel, driver and chip select; and whether this kernel loses clock edges."""
    name = "SPI controller"
    release, built = kernel(root)
    chip_select = {True: "chip select is a GPIO", False: "the controller drives chip select", None: ""}
    parts = [
        computer(root) or "a computer without a device tree",
        f"Linux {release or 'of unknown release'}",
        f"driver {driver_of(device, root) or 'unknown'}",
        chip_select[gpio_selects(device, root)],
    ]
    found = ", ".join(part for part in parts if part)
    if not on_rp1(device, root) or (built is not None and built >= RP1_FIXED):
        return ok(name, found)
    when = "that was built at an unknown time" if built is None else f"of {built}"
    return warning(
        name,
        f"{found}: a kernel {when}, and before February 2025 this driver lost clock edges of transfers that only send; "
        "the controller then takes in nothing until it is reset",
        "update the kernel (sudo apt full-upgrade) and reboot",
    )


def shared(device: str, *, root: Path = ROOT_DIR) -> Result:
    """Whether something else on the bus can delay an emergency stop."""
    name = "SPI bus"
    found = neighbours(device, root)
    if not found:
        return ok(name, "no other driver uses it")
    others = ", ".join(f"{each} (driver {driver})" for each, driver in found)
    return warning(
        name,
        f"{others} {'is' if len(found) == 1 else 'are'} on it, too: an emergency stop waits for two to four of its "
        "transfers",
        f"move it to another bus, or see that none of its transfers takes more than {_LONGEST_MS} ms",
    )
