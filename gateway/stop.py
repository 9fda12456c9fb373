"""Stops all six legs straight over SPI: no Zenoh, no running gateway, and little that could fail or be slow to load."""

import time

from gateway.errors import SpiError
from gateway.protocol.frames import stop_leg
from gateway.settings import Settings
from gateway.spi.bus import bus_for
from gateway.spi.kernel import KernelDevice
from schemas.robot import LEGS


def stop_servos(settings: Settings) -> None:
    """Stop all six legs straight over SPI, repeated as the watchdog's Stops are. Raises SpiError.

    Does not ask for the device's lock: it is run when something went wrong, and a Stop more does no harm.
    """
    bus = bus_for(settings.spi, lambda: KernelDevice(settings.spi.device, settings.spi.speed_hz, exclusive=False))
    bus.open()
    fault: SpiError | None = None
    for repeat in range(1 + settings.watchdog.repeats):
        if repeat:
            time.sleep(settings.watchdog.repeat_interval_ms / 1000)
        for leg in LEGS:
            try:
                bus.write(stop_leg(leg))
            except SpiError as error:  # the next leg's Stop may still get through
                fault = error
    bus.close()
    if fault is not None:
        raise fault
