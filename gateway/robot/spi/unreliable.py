"""A simulated device some of whose transfers fail, as slowly as Linux lets them: for `run --sim --sim-fault`."""

import random
import time
from typing import Final, NamedTuple

from gateway.errors import ConfigError, SpiError
from gateway.robot.spi import Batch, ByteDevice, SpiDevice

_LONGEST_MS: Final = 60_000
"""Longer than any driver hangs and comes back."""


class Faults(NamedTuple):
    """How a simulated device fails."""

    share: float
    """The chance of each transfer, 0 to 1."""
    after_ms: float = 200.0
    """What a failing call takes: Linux waits for 200 ms and more for a transfer that its driver has lost."""


def read(text: str) -> Faults:
    """`SHARE` or `SHARE:MS`, as a person writes it. Raises ConfigError."""
    share, _, after_ms = text.partition(":")
    try:
        faults = Faults(float(share), float(after_ms or Faults._field_defaults["after_ms"]))
    except ValueError:
        faults = Faults(-1)
    if not (0 <= faults.share <= 1 and 0 <= faults.after_ms <= _LONGEST_MS):
        raise ConfigError(
            f"--sim-fault {text}: write a chance from 0 to 1, and how long a failure takes, up to {_LONGEST_MS:g} ms, "
            "such as 0.1:200"
        )
    return faults


class UnreliableDevice(ByteDevice):
    """Passes transfers on to a device. One that fails is lost, and the rest of its call with it.

    The first call passes: it has the Stops of the start, without which the service does not start.
    """

    def __init__(self, device: SpiDevice, faults: Faults) -> None:
        self._device = device
        self._faults = faults
        self._chance = random.Random()  # noqa: S311  (faults, no secrets)
        self._started = False
        self.most_transfers = device.most_transfers

    def transfer(self, batch: Batch) -> None:
        if self._started:
            super().transfer(batch)
        else:
            self._started = True
            self._device.transfer(batch)

    def take(self, data: bytes) -> None:
        if self._chance.random() < self._faults.share:
            time.sleep(self._faults.after_ms / 1000)
            raise SpiError("the transfer failed: Connection timed out (simulated)")
        self._device.transfer(((data, 0),))
