"""Opens an SPI device by the Python package spidev, or as a file on machines without a usable package.

PyPI has spidev as source only, and a robot may have neither a compiler nor a network. Debian 12 and 13 have spidev 3.6,
which cannot open a device by its path.
"""

from typing import Any, Final

USED: Final = "the gateway makes the kernel's calls itself: the Python package spidev is missing, or too old"


def open_device(path: str) -> Any:
    """Return the opened `/dev/spidevB.C`, with `fileno` and `close`. Raises OSError, spidev perhaps others."""
    if are_used():
        return open(path, "r+b", buffering=0)
    import spidev  # noqa: PLC0415

    device = spidev.SpiDev()
    device.open_path(path)
    return device


def are_used() -> bool:
    """Return whether spidev is missing, too old, or built for another Python."""
    try:
        import spidev  # noqa: PLC0415
    except ImportError:
        return True
    return not hasattr(spidev.SpiDev, "open_path")
