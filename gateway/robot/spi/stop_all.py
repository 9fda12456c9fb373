"""Stops all six legs directly: over SPI, over the UART of a wire that has one, or by a plug-in.

This needs no Zenoh and no running gateway, and loads little that could fail or be slow.
"""

import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from gateway.host.directories import runtime_directory
from gateway.host.settings_table import ControllerSettings, SpiSettings, WireSettings
from gateway.model.frames import STOP_REPEAT_MS, STOP_REPEATS, stop_leg
from gateway.robot.spi import Wire, outside
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.cyclic import CyclicBus
from gateway.robot.spi.kernel import KernelDevice
from gateway.robot.spi.outside import Notice
from gateway.robot.spi.uart import SerialUart
from schemas.robot import LEGS

MORE_ROUNDS: Final = 10
"""Further rounds after the repeats, for legs without a Stop. They outlast a fault of a few hundred milliseconds, such
as a device that returns, and do not make systemd wait long."""


# mutants accepted (BreakWithContinue, Step): the first round sets it; the rest does nothing
def stop_servos(
    wire: WireSettings,
    spi: SpiSettings,
    controller: ControllerSettings,
    written: Callable[[], None] = lambda: None,
) -> bool | None:
    """Stop all six legs directly over the wire, repeated like the watchdog's Stops.

    `written` is called after each attempt and must not wait. Return whether a gateway on the same device has noticed,
    or None if no gateway runs there. A running gateway is no obstacle: batches are atomic on the bus, and one more
    Stop does no harm. Raises SpiError if a leg got no Stop, ConfigError if a plug-in cannot be loaded.
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
        notice.give()  # after the Stops, which must not wait for it
        unstopped -= stopped
        fault = fault_now or fault
    bus.close()
    if not unstopped:
        _leave_note(first_ns, time.monotonic_ns())
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


def another_gateway_holds(wire: WireSettings, spi: SpiSettings, controller: ControllerSettings) -> bool:
    """Return whether a gateway certainly holds the device now. False if that is not known. Never raises."""
    with suppress(Exception):
        return outside.is_gateways(_bus(wire, spi, controller, exclusive=False)[1], unknown=False)
    return False


def _bus(wire: WireSettings, spi: SpiSettings, controller: ControllerSettings, *, exclusive: bool) -> tuple[Wire, str]:
    """Return what writes Stops, not yet open, and the path of the file whose lock a gateway watches."""
    if wire.framed:
        return Bus(spi, lambda: KernelDevice(spi.device, spi.speed_hz, exclusive=exclusive)), spi.device
    if wire.has_uart:
        return CyclicBus(None, lambda: SerialUart(controller.uart, exclusive=exclusive)), spi.device
    from gateway.robot.spi.plugin import lock_path, plugin_bus  # noqa: PLC0415  (no Stop over SPI waits for it)

    return plugin_bus(wire, exclusive=exclusive), str(lock_path(wire.name))


def stop_once(bus: Wire, *, opened: bool = False) -> tuple[set[int], Exception | None]:
    """Write one Stop for each leg. Return the legs whose Stop was written, and the last fault.

    The device is opened first, unless it is `opened`. All six Stops are one batch. Legs that failed, even by a bug of
    the gateway, are tried one by one, and the device is reopened after a fault: this may be the last attempt.
    """
    stopped: set[int] = set()
    fault: Exception | None = None
    for legs in (LEGS, *((leg,) for leg in LEGS)):
        if not stopped.isdisjoint(legs):
            continue
        try:
            if not opened:
                bus.open()
                opened = True  # mutants accepted (TrueWithFalse): after a mistake of ours, one opening more
            report = bus.write([stop_leg(leg) for leg in legs], preamble=True)
        except Exception as error:
            fault = error
            continue
        stopped |= {legs[place] for sent in report.sent if sent.received for place in sent.places}
        if report.fault is not None:
            fault, opened = report.fault, False
    return stopped, fault


# ---- a note of when `stop-servos` wrote its Stops, for the black box of the next gateway

_NOTE: Final = "stop-servos"
"""In the service's runtime directory, in memory: a reboot ends both the note and the monotonic clock of its times. Only
people use it, so every error is ignored."""


def _leave_note(first_ns: int, last_ns: int) -> None:
    """Note the times after the first and the last round of Stops, in ns of the monotonic clock. Never raises."""
    folder = runtime_directory()
    if folder is not None:
        with suppress(OSError):
            (folder / _NOTE).write_text(f"{first_ns} {last_ns}")


def take_note() -> tuple[int, ...]:
    """Remove the note and return its times; empty if there is no readable one. Never raises."""
    folder = runtime_directory()
    with suppress(OSError, ValueError):
        if folder is not None:
            found = tuple(map(int, (folder / _NOTE).read_text().split()))
            (folder / _NOTE).unlink()
            return found
    return ()
