"""Probes of the way to the servos: SPI device, bus and clock, framing, calibration, the controller's UART, power board.

Nothing is written to the robot. The published firmware of HexapodProtocol v1.0.0 reads the first byte of an 80-byte
frame as a length of 126, and then ignores Stops until its reset. While a gateway runs, UART and board are not opened:
they belong to the gateway, which reports whether controller and board answer.
"""

import errno
import grp
import os
import stat
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Final

from gateway.host import effective
from gateway.host.directories import state_to_read
from gateway.model.elkapod import FRAME_BYTES
from gateway.model.frames import ONE_LEG_LEN
from gateway.model.framing import Framing
from gateway.onboard import computer
from gateway.onboard.check.table import RESTART, CheckedRobot, Result, Row, failure, first, warning, well
from gateway.own_command import command
from gateway.robot.core.calibrating import ACCEPT_DEFAULT
from gateway.robot.host.calibration_file import load, path_of
from gateway.robot.power.interface import BITRATE, open_bus
from gateway.robot.spi import ioctls, machine, outside
from gateway.robot.spi.bus import CS_CHANGE_NS
from gateway.robot.spi.kernel import KernelDevice
from gateway.robot.spi.plugin import PluginDevice
from gateway.robot.spi.uart import SerialUart
from schemas.robot import LEGS

_SLOW_MS: Final = 20.0
"""Six Stops should not take longer than the shortest watchdog timeout, nor an 80-byte frame than its cycle."""
_ALLOWED: Final = "ttyAMA"
"""The unit's DeviceAllow=: the kernel's name of a Raspberry Pi's PL011 UARTs."""
_CAN: Final = "280"
"""ARPHRD_CAN, in /sys/class/net/…/type."""


# fmt: off
def _node_faults(robot: CheckedRobot, path: str, group: str, absent: str) -> list[Row]:
    """Return the faults of a device node that belongs to `group` with the package. `absent`: the remedy without it."""
    try:
        status = os.stat(path)
    except OSError as error:
        return [failure(error, f"{path}: {error.strerror}", absent)]
    denied, groups = not os.access(path, os.R_OK | os.W_OK), {each.gr_gid: each.gr_name for each in grp.getgrall()}
    owner = groups.get(status.st_gid, "") if status.st_gid and status.st_mode & 0o060 == 0o060 else ""
    may_not = f"{path} may not be opened by this user ({stat.filemode(status.st_mode)})"
    return [
        failure(not stat.S_ISCHR(status.st_mode), f"{path} is no device node", absent),
        failure(denied and robot.service, may_not, f"sudo chgrp {group} {path} && sudo chmod 660 {path} && {RESTART}"),
        failure(denied and owner, may_not, f"sudo usermod -aG {owner} $USER # then log in again"),
        failure(denied, may_not, f"until the next boot: sudo chown $USER {path}"),
    ]


def _fault(attempt: Callable[[], None]) -> Exception | None:
    """Open and close a device, as the service does. Return the error."""
    try:
        attempt()
    except Exception as error:  # also of any of python-can's interfaces
        return error
    return None


def _is_held(error: Exception | None) -> bool:
    return isinstance(cause := error and error.__cause__, OSError) and cause.errno in (errno.EAGAIN, errno.EBUSY)


def _open_faults(path: str, error: Exception | None, what: str) -> list[Row]:
    return [
        failure(_is_held(error), f"{path} is held by another program", f"find and end that program (sudo fuser -v "
                f"{path}), then: {RESTART}"),
        failure(error, str(error), f"is {path} a {what}? see dmesg"),
    ]


# ---- SPI, or a plug-in


def plugin(robot: CheckedRobot) -> Iterator[Result | None]:
    """Open and close the plug-in, unless a gateway holds it."""
    wire = robot.settings.wire
    if wire.built_in is None:
        robot.gateway_runs = effective.running() is not None
        can = [name.replace("_", " ") for name, has in wire.capabilities._asdict().items() if has]
        open_it = partial(PluginDevice, wire.name, wire.plugin, exclusive=False)
        error = None if robot.gateway_runs else _fault(lambda: open_it().close())
        yield first("wire",
            failure(error, str(error), "read what the plug-in needs, and fix [wire] of the configuration"),
            well(f"{wire.name} opens: {type(wire.plugin).__name__}, {', '.join(can) or 'servos one by one'}"))


def spi_bus(robot: CheckedRobot) -> Iterator[Result | None]:
    """The SPI device, its controller and kernel, other devices on the bus, and the clock."""
    spi, protocol, root = robot.settings.spi, robot.settings.wire.built_in, robot.root
    if protocol is None:
        return
    others = ", ".join(sorted(map(str, Path(spi.device).parent.glob("spidev*"))))
    absent = "switch SPI on and reboot: sudo hexapod-gateway setup; without a robot: run --sim"
    rows = _node_faults(robot, spi.device, "spi", f"set spi.device; this machine has {others}" if others else absent)
    device = partial(KernelDevice, spi.device, spi.speed_hz, mode=protocol.spi_mode)
    error = None if any(rows) else _fault(lambda: device().close())
    robot.gateway_runs = _is_held(error) and outside.is_gateways(spi.device)
    yield first("SPI device",
        *rows,
        well(f"{spi.device} is held by a running gateway") if robot.gateway_runs else None,
        *_open_faults(spi.device, error, "SPI device"),
        well(f"{spi.device} opens" + (f"; {ioctls.USED}" if ioctls.are_used() else "")))
    release, built = computer.kernel(root)
    selects = {True: "chip select is a GPIO", False: "the controller drives chip select", None: ""}
    named = (computer.computer(root), release and f"Linux {release}", machine.driver_of(spi.device, root),
             selects[machine.gpio_selects(spi.device, root)])
    found = ", ".join(filter(None, named)) or "nothing is known of it"
    loses = computer.on_rp1(spi.device, root) and (built is None or built < computer.RP1_FIXED)
    when = f"of {built}" if built else "that was built at an unknown time"
    yield first("SPI controller",
        warning(loses, f"{found}: a kernel {when}. Before February 2025 this driver lost clock edges of transfers "
                "that only send; then the controller receives nothing until it is reset",
                "update the kernel (sudo apt full-upgrade) and reboot"),
        well(found))
    others = ", ".join(f"{each} (driver {driver})" for each, driver in computer.neighbours(spi.device, root))
    yield first("SPI bus",  # a neighbour's transfer of 2 ms is what docs/safety.md allows
        warning(others, f"shared with {others}: an emergency stop waits for two to four of its transfers",
                "move it to another bus, or limit its transfers to 2 ms each"),
        well("no other driver uses it"))
    transfers = 1 + (spi.framing is Framing.LENGTH_PREFIXED)
    bits, pause_ms = 8 * (ONE_LEG_LEN + transfers - 1), transfers * (spi.frame_gap_us / 1e3 + CS_CHANGE_NS / 1e6)
    what, takes_ms = "an emergency stop", len(LEGS) * (bits / spi.speed_hz * 1e3 + pause_ms)
    if not protocol.framed:  # Stops do not go over SPI
        what, takes_ms = "a frame", 8 * FRAME_BYTES / spi.speed_hz * 1e3
    takes, known, at = f"{what} takes {takes_ms:.1f} ms to write", protocol.speed_hz, f"{spi.speed_hz / 1e6:g} MHz"
    yield first("SPI speed",
        warning(spi.speed_hz > known or takes_ms > _SLOW_MS, f"{at}; {takes}, and the protocol was measured up to "
                f"{known / 1e6:g} MHz", f"set spi.speed_hz = {known}, or measure a higher clock on your wires"),
        well(f"{at}; {takes}"))


def framing(robot: CheckedRobot) -> Iterator[Result | None]:
    """The framing, and whether the driver is known to release chip select between the transfers of a call."""
    spi, gpio = robot.settings.spi, machine.gpio_selects(robot.settings.spi.device, robot.root)
    (low, high), driver = spi.framing.avoid_cdeg or (0, 0), machine.driver_of(spi.device, robot.root) or "this driver"
    if robot.settings.wire.framed:
        yield first("framing",
            warning(spi.framing is Framing.PLAIN, "plain, as in the protocol document; with it the published STM32 "
                    "firmware hangs until its reset",
                    'set spi.framing = "length-prefixed" for that firmware, and reset it'),
            well(f"{spi.framing}, as {spi.framing.controller} wants it; wire angles from {low / 100:g} up to "
                 f"{high / 100:g} degrees are never sent"))
        yield first("SPI lists",
            well("chip select is a GPIO, which Linux releases between the transfers of a call") if gpio else None,
            warning(spi.framing.needs_chip_select, f"it is unknown whether {driver} releases chip select between the "
                    f"transfers of a call", f"{command('check --move')} shows it: if servo 61 still holds when all "
                    f"are stopped, {computer.SELECT_BY_GPIO}"),
            well(f"{driver} may keep chip select within a call; {spi.framing.controller} ignores it"))


def calibration(robot: CheckedRobot) -> Iterator[Result | None]:
    """The calibration. Without a usable one the service starts, but moves nothing."""
    path = path_of(robot.settings, state_to_read)
    if path is None:
        yield first("calibration", well("is kept in memory only, until the gateway ends (state.path)"))
    else:
        (found, fault), denied = load(path), not os.access(path.parent, os.X_OK)
        yield first("calibration",
            warning(fault and denied, f"you may not read {path}", "sudo hexapod-gateway check"),
            failure(fault, f"{fault}; nothing can be started",
                    f"restore a good file and restart, or, if the robot is as drawn: {command(ACCEPT_DEFAULT)}"),
            well(f"revision {found.revision}, servos that differ: {len(found.servos)} ({path})"))


# ---- the UART


def uart(robot: CheckedRobot) -> Iterator[Result | None]:
    """Open and close the UART, unless a gateway holds it."""
    path, name = robot.settings.controller.uart, Path(robot.settings.controller.uart).resolve().name
    if not robot.settings.wire.has_uart:
        return
    here = ", ".join(sorted(map(str, Path("/dev").glob(f"{_ALLOWED}*")))) or "none"
    setup = f"sudo hexapod-gateway setup --wire {robot.settings.wire.name}"
    absent = f"switch it on and reboot: {setup}; or set controller.uart; here there is {here}"
    console = name in robot.text("/sys/class/tty/console/active").split()
    login = robot.shown(f"serial-getty@{name}.service").get("ActiveState") == "active"
    rows = [
        *_node_faults(robot, path, "dialout", absent),
        failure(console or login, f"{path} has Linux's console or a login, which write to the controller, and read "
                "from it", f"free it, and reboot: {setup}"),
    ]
    runs = robot.gateway_runs
    error = None if any(rows) or runs else _fault(lambda: SerialUart(path).close())
    yield first("UART",
        *rows,
        well(f"{path} is the running gateway's, which reports whether the controller answers") if runs else None,
        *_open_faults(path, error, "UART"),
        warning(robot.service and not name.startswith(_ALLOWED), f"{path} opens, but the unit lets the service open "
                f"{_ALLOWED}… only", "sudo systemctl edit hexapod-gateway, with [Service] "
                f"DeviceAllow=char-{name.rstrip('0123456789')} rw"),
        well(f"{path} opens"))


# ---- the power board


def power(robot: CheckedRobot) -> Iterator[Result | None]:
    """Open and close the interface to the power board, unless it is the gateway's."""
    settings, rows = robot.settings.power, list[Row]()
    path, where = settings.channel, f"{settings.interface} {settings.channel}"
    absent = "plug the adapter in or load its driver, or set power.channel (see dmesg, ip link)"
    if not settings.interface:
        return
    if settings.interface == "slcan":
        rows = _node_faults(robot, path, "dialout", absent)
    elif settings.interface == "socketcan":  # everybody may use it, but only root can switch it on
        kind, flags = (robot.text(f"/sys/class/net/{path}/{each}") for each in ("type", "flags"))
        rows = [
            failure(kind != _CAN, f"{path} is no CAN interface", absent),
            failure(not int(flags or "0", 16) & 1, f"{path} is switched off",  # now and at each boot
                    f"printf '[Match]\\nName={path}\\n[CAN]\\nBitRate={BITRATE}\\nRestartSec=100ms\\n' | sudo tee "
                    f"/etc/systemd/network/80-{path}.network && sudo systemctl enable systemd-networkd && "
                    "sudo systemctl restart systemd-networkd"),
        ]
    elif settings.interface == "sim":
        rows = [warning(path, "is simulated: no servo loses its supply", 'set power.interface; "" is none')]
    error = None if any(rows) or robot.gateway_runs else _fault(lambda: open_bus(settings).shutdown())
    opens = "is the running gateway's" if robot.gateway_runs else "opens"
    yield first("power board", *rows, failure(error, f"{where}: {error}", "see dmesg, and the settings of [power]"),
                well(f"{where} {opens}; a gateway's `status` shows whether the board answers"))


# fmt: on
PROBES: Final = (plugin, spi_bus, uart, framing, calibration)
