"""Makes the wire that the settings name, to a real or a simulated controller."""

import logging
from collections.abc import Callable
from functools import partial
from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.host.descriptors import Spare
from gateway.host.settings_table import SpiSettings, WireSettings
from gateway.host.shared_page import SensedPage, ServoPage
from gateway.model.frames import STOP_REPEAT_MS, STOP_REPEATS
from gateway.own_command import command
from gateway.robot.protocol import Wire
from gateway.robot.settings import Settings
from gateway.robot.spi import DuplexDevice, SpiDevice
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.cyclic import CyclicBus
from gateway.robot.spi.kernel import KernelDevice
from gateway.robot.spi.machine import driver_of, gpio_selects
from gateway.robot.spi.plugin import PluginBus
from gateway.robot.spi.uart import SerialUart, Uart

BEFORE_FRAMES_MS: Final = (STOP_REPEATS + 0.5) * STOP_REPEAT_MS
"""elkapod-2025's first frame waits this long, until the first shutdown has been repeated."""

logger = logging.getLogger(__name__)
_simulator = logging.getLogger("gateway.simulation.controller")


def device_opener(settings: Settings, *, simulated: bool, page: ServoPage | None = None) -> Callable[[], SpiDevice]:
    """Return a function that opens the bus's device. A simulated controller keeps its state when it is reopened."""
    if not simulated:
        spare = Spare()
        return lambda: KernelDevice(settings.spi.device, settings.spi.speed_hz, spare=spare)
    from gateway.simulation.controller import SimulatedController  # noqa: PLC0415  (a robot's first Stops need none)

    controller = SimulatedController(settings.spi.framing, on_change=_simulator.debug, page=page)
    return lambda: controller


def wire(
    settings: Settings,
    *,
    simulated: bool,
    page: ServoPage | None = None,
    sensed: SensedPage | None = None,
) -> Wire:
    """Return the wire to the robot's controller, not yet open. `page` and `sensed` belong to a simulated body."""
    protocol = settings.wire.built_in
    if protocol is None and not simulated:
        return PluginBus(settings.wire)
    if protocol is None or protocol.framed:
        return Bus(settings.spi, device_opener(settings, simulated=simulated, page=page))
    spare, spi, uart = Spare(), settings.spi, settings.controller.uart
    open_device: Callable[[], DuplexDevice]
    open_uart: Callable[[], Uart]
    if simulated:
        from gateway.simulation.elkapod import SimulatedElkapod, SimulatedUart  # noqa: PLC0415  (likewise)

        controller = SimulatedElkapod(on_change=_simulator.debug, page=page, sensed=sensed)
        open_device, open_uart = (lambda: controller), (lambda: SimulatedUart(controller))
    else:
        open_device = partial(KernelDevice, spi.device, spi.speed_hz, mode=protocol.spi_mode, spare=spare)
        open_uart = partial(SerialUart, uart)
    return CyclicBus(
        open_device,
        open_uart,
        silent_ns=round(settings.controller.silent_ms * NS_PER_MS),
        before_frames_ns=round(BEFORE_FRAMES_MS * NS_PER_MS),
        fed_singly=bool(settings.power.interface),
    )


def warn_of_driver(wire: WireSettings, spi: SpiSettings, *, simulated: bool) -> None:
    """Warn if the driver may not release chip select between the transfers of a call, as `plain` framing needs."""
    if simulated:
        return
    if wire.framed and spi.framing.needs_chip_select and not gpio_selects(spi.device):
        logger.warning(
            "it is not known whether %s releases chip select between the transfers of one call; if it does not, an "
            "emergency stop stops only one leg. Test it: %s",
            driver_of(spi.device) or "the driver of this SPI bus",
            command("check --move"),
        )
