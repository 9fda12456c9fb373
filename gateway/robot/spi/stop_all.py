"""Stops all six legs straight over SPI, over the UART of a wire that has one, or by a plug-in.

No Zenoh, no running gateway, and little that could fail or be slow to load.
"""

import time
from collections.abc import Callable
from typing import Final

from gateway.host.settings_table import ControllerSettings, SpiSettings, WireSettings
from gateway.model.frames import STOP_REPEAT_MS, STOP_REPEATS, stop_leg
from gateway.robot.host import stop_note
from gateway.robot.protocol import Wire
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.cyclic import CyclicBus
from gateway.robot.spi.kernel import KernelDevice
from gateway.robot.spi.outside import Notice
from gateway.robot.spi.uart import SerialUart
from schemas.robot import LEGS

MORE_ROUNDS: Final = 10
"""How often legs that got no Stop are tried again after the repeats. This outlasts a fault of a few hundred
milliseconds, such as a device that comes back, and systemd still does not wait long."""


def stop_servos(
    wire: WireSettings,
    spi: SpiSettings,
    controller: ControllerSettings,
    written: Callable[[], None] = lambda: None,
) -> bool | None:
    """Stop all six legs straight over the wire, repeated as the watchdog's Stops are. Raises SpiError, ConfigError.

    `written` is called behind the first attempt to stop each leg, and must not wait.

    Returns whether a gateway on the same device has noticed; None: no gateway runs there.

    It also runs while a gateway holds the device: something went wrong, and one more Stop does no harm. Each batch is
    atomic on the bus, so none comes into a frame of the gateway's.
    """
    bus, lock = _bus(wire, spi, controller, exclusive=False)
    notice = Notice(lock)
    unstopped = set(LEGS)
    fault: Exception | None = None
    first_ns = 0
    for repeat in range(1 + STOP_REPEATS + MORE_ROUNDS):
        if repeat > STOP_REPEATS and not unstopped:
            break
        if repeat:
            time.sleep(STOP_REPEAT_MS / 1000)
        stopped, fault_now = stop_once(bus)
        first_ns = first_ns if unstopped < set(LEGS) else time.monotonic_ns()
        written()
        notice.give()  # after the first Stops, which must not wait for it
        unstopped -= stopped
        fault = fault_now or fault
    bus.close()
    if not unstopped:
        stop_note.leave(stop_note.StopNote(first_ns, time.monotonic_ns()))
    noticed = notice.end()
    if unstopped and fault is not None:
        raise fault
    return noticed if notice.gateway_runs else None


def stop_before_service(wire: WireSettings, spi: SpiSettings, controller: ControllerSettings) -> None:
    """Stop all six legs once, unless another gateway holds the device. Raises ConfigError."""
    bus, _ = _bus(wire, spi, controller, exclusive=True)
    try:
        stop_once(bus)
    finally:
        bus.close()


def _bus(wire: WireSettings, spi: SpiSettings, controller: ControllerSettings, *, exclusive: bool) -> tuple[Wire, str]:
    """Return what writes Stops, not yet open, and the path of the file whose lock a gateway watches."""
    if wire.framed:
        return Bus(spi, lambda: KernelDevice(spi.device, spi.speed_hz, exclusive=exclusive)), spi.device
    if wire.has_uart:
        return CyclicBus(None, lambda: SerialUart(controller.uart, exclusive=exclusive)), spi.device
    from gateway.robot.spi.plugin import PluginBus, lock_path  # noqa: PLC0415  (no Stop over SPI waits for it)

    return PluginBus(wire, exclusive=exclusive), str(lock_path(wire.name))


def stop_once(bus: Wire, *, opened: bool = False) -> tuple[set[int], Exception | None]:
    """One Stop for each leg: the legs whose Stop was written, and what failed last.

    Unless it is `opened` already, the device is opened first. All six are one batch. What of it failed, even from a bug
    of ours, is tried leg by leg, with the device opened again where it was at fault: this is the last attempt to stop
    the robot.
    """
    stopped: set[int] = set()
    fault: Exception | None = None
    for legs in (LEGS, *((leg,) for leg in LEGS)):
        if not stopped.isdisjoint(legs):
            continue
        try:
            if not opened:
                bus.open()
                opened = True
            report = bus.write([stop_leg(leg) for leg in legs], preamble=True)
        except Exception as error:
            fault = error
            continue
        stopped |= {legs[sent.place] for sent in report.sent if sent.received}
        if report.fault is not None:
            fault, opened = report.fault, False
    return stopped, fault
