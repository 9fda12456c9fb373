"""Stops all six legs straight over SPI: no Zenoh, no running gateway, and little that could fail or be slow to load."""

import time
from typing import Final

from gateway.errors import SpiError
from gateway.protocol.frames import stop_leg
from gateway.settings import Settings
from gateway.spi.bus import Bus, bus_for
from gateway.spi.kernel import KernelDevice
from schemas.robot import LEGS

MORE_ROUNDS: Final = 10
"""How often legs that got no Stop are tried again, past the repeats: a fault of a few hundred milliseconds, such as a
device that comes back, is outlasted, and the service manager still does not wait long."""
MOST_PAUSE_MS: Final = 20.0
"""Between those."""


def stop_servos(settings: Settings) -> None:
    """Stop all six legs straight over SPI, repeated as the watchdog's Stops are. Raises SpiError.

    Does not ask for the device's lock: it is run when something went wrong, and a Stop more does no harm. Beside a
    gateway that runs, its frames come between that one's, never into them.
    """

    def open_device() -> KernelDevice:
        return KernelDevice(settings.spi.device, settings.spi.speed_hz, exclusive=False)

    bus = bus_for(settings.spi, open_device, beside=True)
    unstopped = set(LEGS)
    fault: SpiError | None = None
    for repeat in range(1 + settings.watchdog.repeats + MORE_ROUNDS):
        if repeat > settings.watchdog.repeats and not unstopped:
            break
        if repeat:
            pause_ms = settings.watchdog.repeat_interval_ms
            time.sleep((pause_ms if repeat <= settings.watchdog.repeats else min(pause_ms, MOST_PAUSE_MS)) / 1000)
        stopped, fault_now = _stop_once(bus)
        unstopped -= stopped
        fault = fault_now or fault
    bus.close()
    if unstopped and fault is not None:
        raise fault


def _stop_once(bus: Bus) -> tuple[set[int], SpiError | None]:
    """One Stop for each leg, on a device opened for it: the legs whose Stop was written, and what failed last.

    Opening writes the preamble, which brings a controller in step that something else put out of it.
    """
    stopped: set[int] = set()
    fault: SpiError | None = None
    in_step = False
    for leg in LEGS:
        try:
            if not in_step:
                bus.open()
            in_step = True
            bus.write(stop_leg(leg))
            stopped.add(leg)
        except SpiError as error:  # the next leg's Stop may still get through
            fault, in_step = error, False
    return stopped, fault
