"""The power board of `[power]`: its interface, whether it answers, and what it says of itself.

It is asked only, and only while no gateway runs: the interface is the gateway's then.
"""

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from gateway.allowance import NS_PER_S
from gateway.errors import GatewayError
from gateway.model import power_board
from gateway.model.power_board import (
    ASK_ERROR,
    ASK_RAILS,
    CONVERTERS_1_TO_3_MV,
    SUPPLY_BATTERY_MV,
    TEMPERATURES_C,
    BoardError,
    Rails,
)
from gateway.onboard.check import nodes, service_user
from gateway.onboard.check.result import Result, failure, ok, warning
from gateway.robot.power.interface import BITRATE, open_bus, received, send
from gateway.robot.sections import PowerSettings
from gateway.robot.spi.machine import ROOT_DIR

if TYPE_CHECKING:
    import can

_NAME: Final = "power board"
_ROUNDS: Final = 4
"""One question may be lost, and the board has four kinds of errors, each shown once."""
_ROUND_S: Final = 0.1
"""The board answers within 2 ms."""
_CAN: Final = "280"
"""ARPHRD_CAN, in /sys/class/net/…/type."""
_SILENT: Final = (
    "press its power button (in standby it is silent); see that CAN-H and CAN-L lead to it, with a resistor of 120 Ω "
    "at each end, and that the interface has its bit rate, 1 Mbit/s"
)
_ERROR: Final = "remove the cause; a reset of the gateway (after an emergency stop) then deletes it"


def results(settings: PowerSettings, *, gateway_runs: bool, root: Path = ROOT_DIR) -> Iterator[Result]:
    """Nothing where no board is set up."""
    if not settings.interface:
        return
    if settings.interface == "sim":
        yield warning(_NAME, "is simulated: no servo loses its supply", 'set power.interface; "" is none')
        return
    lack = _lack(settings, root)
    if lack is not None:
        yield lack
        return
    if gateway_runs:
        where = f"{settings.interface} {settings.channel}"
        yield ok(_NAME, f"{where} is the running gateway's, whose status has whether the board answers")
    else:
        yield from _answers(settings)


def _answers(settings: PowerSettings) -> Iterator[Result]:
    where = f"{settings.interface} {settings.channel}"
    try:
        bus = open_bus(settings)
    except GatewayError as error:
        yield failure(_NAME, str(error), "see dmesg, and the settings of [power]")
        return
    try:
        rails, errors = asked(bus, settings)
    except Exception as error:  # from any of python-can's interfaces
        yield failure(_NAME, f"{where}: {error}", "see dmesg")
        return
    finally:
        bus.shutdown()
    if not rails:
        yield failure(_NAME, f"{where} opens, and the board does not answer", _SILENT)
        return
    yield ok(_NAME, f"answers on {where}{_values(rails)}")
    for each in errors:
        sentence, mask = power_board.explained(each)
        servos = [str(servo) for place, servo in enumerate(settings.outputs) if mask >> place & 1]
        without = f"; no supply for {', '.join(servos)}" if servos else ""
        yield warning(_NAME, f"{sentence}{without}", _ERROR)


def asked(
    bus: "can.BusABC", settings: PowerSettings, clock: Callable[[], int] = time.monotonic_ns
) -> tuple[dict[int, tuple[int, ...]], list[BoardError]]:
    """What the board answers: its rails by the question's identifier, and its errors."""
    rails: dict[int, tuple[int, ...]] = {}
    errors: list[BoardError] = []
    for _ in range(_ROUNDS):
        for question in (*(each for each in ASK_RAILS if each.id not in rails), ASK_ERROR):
            send(bus, question, _ROUND_S)
        end_ns = clock() + round(_ROUND_S * NS_PER_S)
        while (left_ns := end_ns - clock()) > 0:
            message = bus.recv(left_ns / NS_PER_S)
            frame = None if message is None else received(message, settings)
            match None if frame is None else power_board.read(frame):
                case Rails(identifier, values):
                    rails[identifier] = values
                case BoardError() as error:
                    errors += [] if error in errors else [error]
    return rails, errors


def _values(rails: dict[int, tuple[int, ...]]) -> str:
    said = []
    if SUPPLY_BATTERY_MV in rails:
        said.append(f"supply {rails[SUPPLY_BATTERY_MV][0] / 1000:.1f} V")
    if CONVERTERS_1_TO_3_MV in rails:
        shown = ", ".join(f"{mv / 1000:.1f}" for mv in rails[CONVERTERS_1_TO_3_MV])
        said.append(f"the servos' converters {shown} V")
    if TEMPERATURES_C in rails:
        said.append(f"{max(rails[TEMPERATURES_C])} °C at most")
    return f": {'; '.join(said)}" if said else ""


def _lack(settings: PowerSettings, root: Path) -> Result | None:
    if settings.interface == "slcan":
        return _terminal(Path(settings.channel))
    if settings.interface == "socketcan":
        return _network(settings, root / "sys/class/net" / settings.channel)
    return None


def _terminal(node: Path) -> Result | None:
    """Of an adapter with slcan."""
    lack = nodes.missing(_NAME, node, "power.channel", "plug the adapter in, or set power.channel (see dmesg)")
    if lack is not None or os.access(node, os.R_OK | os.W_OK):
        return lack
    group = nodes.group_that_may(node)
    fix = (
        f"the service's user is in dialout: sudo chgrp dialout {node} && sudo chmod 660 {node}"
        if group is None or service_user.uid() is not None
        else f"sudo usermod -aG {group} {nodes.user()} # then log in again"
    )
    return nodes.denied(_NAME, node, fix)


def _network(settings: PowerSettings, folder: Path) -> Result | None:
    """Of a CAN interface of the kernel: anybody may use it, and only root can switch it on."""
    name = settings.channel
    up = f"sudo ip link set {name} up type can bitrate {BITRATE} restart-ms 100"
    try:
        kind, flags = (folder / "type").read_text().strip(), int((folder / "flags").read_text(), 16)
    except (OSError, ValueError):
        fix = "plug the adapter in or load its driver (ip link names what there is), or set power.channel"
        return failure(_NAME, f"there is no network interface {name}", fix)
    if kind != _CAN:
        return failure(_NAME, f"{name} is no CAN interface", "set power.channel to one (ip link)")
    if not flags & 1:
        return failure(_NAME, f"{name} is switched off", up)
    return None
