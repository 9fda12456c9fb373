"""Who is on the device: the gateway's own bus in this process, and other programs. Without Zenoh, so it loads fast."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from gateway.host.settings_table import SpiSettings
from gateway.model.framing import Framing
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.kernel import KernelDevice
from tests.kernel.inside import wire
from tests.support.child import Child

SPEED_HZ = 2_500_000
OURS = (SPEED_HZ, 8, 0)
"""Speed, bits and mode."""
GAP_US = 50


@contextmanager
def bus(framing: Framing) -> Iterator[Bus]:
    """The gateway's bus on the device, opened."""
    found = Bus(SpiSettings(framing=framing), lambda: KernelDevice(wire.DEVICE, SPEED_HZ))
    found.open()
    try:
        yield found
    finally:
        found.close()


@contextmanager
def program(text: str, *arguments: str) -> Iterator[Child]:
    """Another Python program."""
    with Child([sys.executable, "-c", text, *arguments], {"PATH": "/usr/bin:/bin"}) as child:
        yield child
