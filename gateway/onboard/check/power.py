"""The power board of `[power]`: its interface, whether it answers, and what it says of itself.

It is asked only, and only while no gateway runs: the interface is the gateway's then.
"""

import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Final

from gateway.allowance import NS_PER_S
from gateway.errors import GatewayError
from gateway.model import power_board
from gateway.model.power_board import ASK_RAILS, CONVERTERS_1_TO_3_MV, SUPPLY_BATTERY_MV, TEMPERATURES_C, Rails
from gateway.onboard.check.device import JOIN_GROUP, NO_NODE, denied, node
from gateway.onboard.check.table import CheckedRobot, Probe, Seen, always, failure, warning
from gateway.robot.power.interface import BITRATE, open_bus, received, send
from gateway.robot.sections import PowerSettings

if TYPE_CHECKING:
    import can

_ROUNDS: Final = 4
"""One question may be lost."""
_ROUND_S: Final = 0.1
"""The board answers within 2 ms."""
_CAN: Final = "280"
"""ARPHRD_CAN, in /sys/class/net/…/type."""


def _board(robot: CheckedRobot) -> Iterator[Seen]:
    """Nothing where no board is set up."""
    power, folder = robot.settings.power, robot.root / "sys/class/net" / robot.settings.power.channel
    if not power.interface:
        return
    seen = node(power.channel) if power.interface == "slcan" else Seen(path=power.channel, lack="", denied=False)
    seen.absent, seen.off, seen.bitrate = _PLUG, False, BITRATE
    seen.where, seen.simulated = f"{power.interface} {power.channel}", power.interface == "sim"
    seen.error = seen.silent = ""
    if power.interface == "socketcan":  # anybody may use it, and only root can switch it on
        try:
            kind, flags = (folder / "type").read_text().strip(), int((folder / "flags").read_text(), 16)
            seen.lack, seen.off = "" if kind == _CAN else "is no CAN interface", not flags & 1
        except (OSError, ValueError):
            seen.lack = "is no network interface"
    seen.answers = f"{seen.where} is the running gateway's, whose status has whether the board answers"
    if not (robot.gateway_runs or seen.simulated or seen.lack or seen.denied or seen.off):
        try:
            with open_bus(power) as bus:
                rails = asked(bus, power)
            seen.silent, seen.answers = not rails, f"answers on {seen.where}{_values(rails)}"
        except GatewayError as error:
            seen.error = str(error)
        except Exception as error:  # from any of python-can's interfaces
            seen.error = f"{seen.where}: {error}"
    yield seen


def asked(
    bus: "can.BusABC", settings: PowerSettings, clock: Callable[[], int] = time.monotonic_ns
) -> dict[int, tuple[int, ...]]:
    """The rails that the board answers, by the question's identifier."""
    rails: dict[int, tuple[int, ...]] = {}
    for _ in range(_ROUNDS):
        for question in (each for each in ASK_RAILS if each.id not in rails):
            send(bus, question, _ROUND_S)
        end_ns = clock() + round(_ROUND_S * NS_PER_S)
        while (left_ns := end_ns - clock()) > 0 and len(rails) < len(ASK_RAILS):
            message = bus.recv(left_ns / NS_PER_S)
            frame = None if message is None else received(message, settings)
            read = None if frame is None else power_board.read(frame)
            if isinstance(read, Rails):
                rails[read.question] = read.values
    return rails


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


_PLUG: Final = "plug the adapter in or load its driver, or set power.channel (see dmesg, ip link)"
# fmt: off
BOARD: Final = Probe("power board", _board, (
    warning(lambda r: r.simulated, "is simulated: no servo loses its supply", 'set power.interface; "" is none'),
    NO_NODE,
    denied(lambda r: r.service or not r.group,
           "the service's user is in dialout: sudo chgrp dialout {path} && sudo chmod 660 {path}"),
    denied(always, JOIN_GROUP),
    failure(lambda r: r.off, "{path} is switched off",
            "sudo ip link set {path} up type can bitrate {bitrate} restart-ms 100"),
    failure(lambda r: r.error, "{error}", "see dmesg, and the settings of [power]"),
    failure(lambda r: r.silent, "{where} opens, and the board does not answer",
            "press its power button (in standby it is silent); see that CAN-H and CAN-L lead to it, with a resistor of "
            "120 Ω at each end, and that the interface has its bit rate, 1 Mbit/s"),
), "{answers}")
# fmt: on
