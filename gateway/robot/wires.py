"""Makes the wire that the settings name, to a real or a simulated controller."""

import logging
from functools import partial
from pathlib import Path
from typing import NamedTuple

from gateway.host.descriptors import Spare
from gateway.host.shared_page import SensedPage, ServoPage
from gateway.model.protocols import FRAMED
from gateway.robot.settings import Settings
from gateway.robot.spi import Wire
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.cyclic import CyclicBus
from gateway.robot.spi.kernel import KernelDevice
from gateway.robot.spi.plugin import plugin_bus
from gateway.robot.spi.uart import SerialUart

_simulator = logging.getLogger("gateway.simulation.controller")


class SimulatedParts(NamedTuple):
    """The simulated parts of a robot, and how they are reached; none by default."""

    controller: bool = False
    page: ServoPage | None = None
    """Shared memory from which the body, or else the power board, reads the servos' commanded angles.

    The power board writes to it which servos are powered.
    """
    sensed: SensedPage | None = None
    """Shared memory to which the body's process writes its sensors' values."""
    body_id: str | None = None
    """The Zenoh id of the body's process."""
    folder: Path | None = None
    """Private folder of the socket that connects the body's process with the gateway."""
    board_channel: str | None = None
    """The power board's terminal."""


def wire(settings: Settings, simulated: SimulatedParts) -> Wire:
    """Return the wire to the robot's controller, not yet open. A simulated controller keeps its state when reopened."""
    protocol, spi, spare = settings.wire.built_in, settings.spi, Spare()
    if protocol is not None and protocol is not FRAMED:
        cyclic = partial(CyclicBus, fed_singly=bool(settings.power.interface))
        if simulated.controller:
            from gateway.simulation.elkapod import SimulatedElkapod  # noqa: PLC0415  (first Stops need none)

            elkapod = SimulatedElkapod(on_change=_simulator.debug, page=simulated.page, sensed=simulated.sensed)
            return cyclic(lambda: elkapod, lambda: elkapod)
        return cyclic(
            partial(KernelDevice, spi.device, spi.speed_hz, mode=protocol.spi_mode, spare=spare),
            partial(SerialUart, settings.controller.uart, spare=spare),
        )
    if simulated.controller:
        from gateway.simulation.controller import SimulatedController  # noqa: PLC0415  (likewise)

        framed = SimulatedController(spi.framing, on_change=_simulator.debug, page=simulated.page)
        return Bus(spi, lambda: framed)
    if protocol is None:
        return plugin_bus(settings.wire, spare=spare)
    return Bus(spi, partial(KernelDevice, spi.device, spi.speed_hz, spare=spare))
