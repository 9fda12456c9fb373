"""Probes of the way to the servos: SPI device, bus and clock, framing, calibration, the controller's UART, power board.

Nothing is written to the robot. The published firmware of HexapodProtocol v1.0.0 reads the first byte of an 80-byte
frame as a length of 126, and then ignores Stops until its reset. A power board is only queried. While a gateway runs,
UART and board are not read: they belong to the gateway.
"""

import errno
import grp
import os
import pwd
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from gateway.allowance import NS_PER_MS
from gateway.errors import GatewayError, SpiError
from gateway.host import effective
from gateway.host.settings_table import PowerSettings
from gateway.model import power_board
from gateway.model.elkapod import FRAME_BYTES, Heartbeats
from gateway.model.frames import ONE_LEG_LEN
from gateway.model.framing import Framing
from gateway.model.protocols import FRAMED, WITH_UART
from gateway.onboard.check.table import RESTART, CheckedRobot, Probes, Row, Rows, failure, text, warning, well
from gateway.own_command import command
from gateway.robot.core.calibrating import ACCEPT_DEFAULT
from gateway.robot.host.calibration_file import load, path_to_read
from gateway.robot.power.interface import BITRATE, open_bus, received, send
from gateway.robot.spi import ioctls, machine, outside
from gateway.robot.spi.bus import CS_CHANGE_NS
from gateway.robot.spi.kernel import KernelDevice
from gateway.robot.spi.plugin import PluginDevice
from gateway.robot.spi.uart import SerialUart
from schemas.robot import LEGS

if TYPE_CHECKING:
    import can

_SLOW_MS: Final = 20.0
"""Six Stops should not take longer than the shortest watchdog timeout, nor an 80-byte frame than its cycle."""
_ALLOWED: Final = "ttyAMA"
"""The unit's DeviceAllow=: the kernel's name of a Raspberry Pi's PL011 UARTs."""
_CYCLE_S: Final = 0.02
"""The cycle of the robot's own driver. That driver restarts after 0.1 s without a heartbeat."""
_PI_5: Final = ("Raspberry Pi 5", "Raspberry Pi Compute Module 5")
_ROUNDS, _ROUND_S = 4, 0.1
"""A query to the board may be lost. The board answers within 2 ms."""
_CAN: Final = "280"
"""ARPHRD_CAN, in /sys/class/net/…/type."""


def _node_faults(robot: CheckedRobot, path: str, group: str, absent: str) -> Rows:
    """Return the faults of a device node that belongs to `group` with the package. `absent`: the remedy without it."""
    user = _name(pwd.getpwuid, os.geteuid())
    try:
        status = os.stat(path)
    except OSError as error:
        lack = "does not exist" if isinstance(error, FileNotFoundError) else f"cannot be read ({error.strerror})"
        return [failure(lack, f"{path} {lack}", absent)]
    owner = _name(grp.getgrgid, status.st_gid)
    denied = not os.access(path, os.R_OK | os.W_OK)
    by_group = denied and status.st_gid and status.st_mode & 0o060 == 0o060
    may_not = f"{user} may not open {path} ({stat.filemode(status.st_mode)}, group {owner})"
    return [
        failure(not stat.S_ISCHR(status.st_mode), f"{path} is no device node", absent),
        failure(denied and robot.service, may_not, f"sudo chgrp {group} {path} && sudo chmod 660 {path} && {RESTART}"),
        failure(by_group, may_not, f"sudo usermod -aG {owner} {user} # then log in again"),
        failure(denied, may_not, f"until the next boot: sudo chown {user} {path}"),
    ]


def _name(find: Callable[[int], tuple[object, ...]], number: int) -> str:
    """Return the name of a user or group; the number if it has no name."""
    with suppress(KeyError):
        return str(find(number)[0])
    return str(number)


# ---- SPI


def _device(robot: CheckedRobot) -> Iterator[Rows]:
    """Open and set up the device as the service does, and close it at once."""
    spi, protocol = robot.settings.spi, robot.settings.wire.built_in
    if protocol is None:
        return
    path, error = spi.device, None
    others = ", ".join(sorted(map(str, Path(path).parent.glob("spidev*"))))
    absent = "switch SPI on and reboot: sudo hexapod-gateway setup; without a robot: run --sim"
    rows = _node_faults(robot, path, "spi", f"set spi.device; this machine has {others}" if others else absent)
    if not any(rows):
        try:
            KernelDevice(path, spi.speed_hz, mode=protocol.spi_mode).close()
        except SpiError as why:
            error = why
    held = error is not None and isinstance(error.__cause__, BlockingIOError)
    robot.gateway_runs = held and outside.is_gateways(path)
    opens = f"opens, as {_name(pwd.getpwuid, os.geteuid())}" + (f"; {ioctls.USED}" if ioctls.are_used() else "")
    yield [
        *rows,
        failure(held and not robot.gateway_runs, f"{path} is locked by another program, not by a gateway",
                f"find and end that program (sudo fuser -v {path}), then: {RESTART}"),
        failure(error and not held, str(error), f"is {path} a SPI device? see dmesg"),
        well(f"{path} is held by a running gateway; a second one would be rejected") if held else None,
        well(f"{path} {opens}"),
    ]  # fmt: skip


def _carrier(robot: CheckedRobot) -> Iterator[Rows]:
    """Computer, kernel, driver and chip select, and whether this kernel loses clock edges."""
    device, root = robot.settings.spi.device, robot.root
    release, built = machine.kernel(root)
    selects = {True: ", chip select is a GPIO", False: ", the controller drives chip select", None: ""}
    found = f"{machine.computer(root) or 'a computer without a device tree'}, Linux {release or 'of unknown release'}, "
    found += f"driver {machine.driver_of(device, root) or 'unknown'}{selects[machine.gpio_selects(device, root)]}"
    loses = machine.on_rp1(device, root) and (built is None or built < machine.RP1_FIXED)
    when = f"of {built}" if built else "that was built at an unknown time"
    yield [] if robot.settings.wire.built_in is None else [
        warning(loses, f"{found}: a kernel {when}. Before February 2025 this driver lost clock edges of transfers "
                "that only send; then the controller receives nothing until it is reset",
                "update the kernel (sudo apt full-upgrade) and reboot"),
        well(found),
    ]  # fmt: skip


def _neighbours(robot: CheckedRobot) -> Iterator[Rows]:
    """Other devices on the same bus. A neighbour's transfer of 2 ms is what docs/safety.md allows."""
    found = machine.neighbours(robot.settings.spi.device, robot.root)
    others = ", ".join(f"{each} (driver {driver})" for each, driver in found)
    yield [] if robot.settings.wire.built_in is None else [
        warning(others, f"shared with {others}: an emergency stop waits for two to four of its transfers",
                "move it to another bus, or limit its transfers to 2 ms each"),
        well("no other driver uses it"),
    ]  # fmt: skip


def _speed(robot: CheckedRobot) -> Iterator[Rows]:
    """The clock, and how long six Stops take on the wire, or a frame if Stops do not go over SPI."""
    spi, protocol = robot.settings.spi, robot.settings.wire.built_in
    if protocol is None:
        return
    transfers = 1 + (spi.framing is Framing.LENGTH_PREFIXED)
    bits, pause_ms = 8 * (ONE_LEG_LEN + transfers - 1), transfers * (spi.frame_gap_us / 1e3 + CS_CHANGE_NS / 1e6)
    what, takes_ms = "an emergency stop", len(LEGS) * (bits / spi.speed_hz * 1e3 + pause_ms)
    if protocol is not FRAMED:
        what, takes_ms = "a frame", 8 * FRAME_BYTES / spi.speed_hz * 1e3
    takes, known = f"{what} takes {takes_ms:.1f} ms to write", protocol.speed_hz
    yield [
        warning(spi.speed_hz > known, f"{_megahertz(spi.speed_hz)} is above {_megahertz(known)}, the highest at which "
                "the protocol was measured", f"set spi.speed_hz = {known} or less, or measure the clock on your wires"),
        warning(takes_ms > _SLOW_MS, f"{_megahertz(spi.speed_hz)} is slow: {takes}", f"set spi.speed_hz = {known}"),
        well(f"{_megahertz(spi.speed_hz)}; {takes}"),
    ]  # fmt: skip


def _megahertz(hz: int) -> str:
    return f"{hz / 1e6:g} MHz" if hz >= 10_000 else f"{hz} Hz"


def _framing(robot: CheckedRobot) -> Iterator[Rows]:
    framing, (low, high) = robot.settings.spi.framing, robot.settings.spi.avoid_cdeg or (0, 0)
    yield [] if not robot.settings.wire.framed else [
        warning(framing is Framing.PLAIN, "plain, as in the protocol document; with it the published STM32 firmware "
                "hangs until its reset", 'set spi.framing = "length-prefixed" for that firmware, and reset it'),
        well(f"{framing}, as {framing.controller} wants it; wire angles from {low / 100:g} up to {high / 100:g} "
             "degrees are never sent"),
    ]  # fmt: skip


def _lists(robot: CheckedRobot) -> Iterator[Rows]:
    """Whether the driver is known to release chip select between the transfers of a call."""
    spi, gpio = robot.settings.spi, machine.gpio_selects(robot.settings.spi.device, robot.root)
    driver = machine.driver_of(spi.device, robot.root) or "this driver"
    how = f"{driver} may keep chip select within a call; {spi.framing.controller} ignores it"
    yield [] if not robot.settings.wire.framed else [
        well("chip select is a GPIO, which Linux releases between the transfers of a call") if gpio else None,
        warning(spi.framing.needs_chip_select, f"it is unknown whether {driver} releases chip select between the "
                f"transfers of a call", f"{command('check --move')} shows it: if servo 61 still holds when all are "
                f"stopped, {machine.SELECT_BY_GPIO}"),
        well(how),
    ]  # fmt: skip


def _calibration(robot: CheckedRobot) -> Iterator[Rows]:
    """The calibration. Without a usable one the service starts, but moves nothing."""
    path = path_to_read(robot.settings)
    if path is None:
        yield [well("is kept in memory only, until the gateway ends (state.path)")]
    elif path.parent.exists() and not os.access(path.parent, os.X_OK):
        yield [warning(path, f"you may not read {path}", "sudo hexapod-gateway check")]
    else:
        found, fault = load(path)
        yield [
            failure(fault, f"{fault}; nothing can be started",
                    f"restore a good file and restart, or, if the robot is as drawn: {command(ACCEPT_DEFAULT)}"),
            well(f"revision {found.revision}, servos that differ: {len(found.servos)} ({path})"),
        ]  # fmt: skip


def _plugin(robot: CheckedRobot) -> Iterator[Rows]:
    """Open and close the plug-in, unless a gateway holds it."""
    wire, used, error = robot.settings.wire, effective.read(), None
    if wire.built_in is not None:
        return
    robot.gateway_runs = used is not None and used.runs
    can = [name.replace("_", " ") for name, has in wire.capabilities._asdict().items() if has]
    try:
        if not robot.gateway_runs:
            PluginDevice(wire.name, wire.plugin, exclusive=False).close()
    except SpiError as why:
        error = why
    yield [
        failure(error, str(error), "read what the plug-in needs, and fix [wire] of the configuration"),
        well(f"{wire.name} opens: {type(wire.plugin).__name__}, {', '.join(can) or 'servos one by one'}"),
    ]


# ---- the UART


def _uart(robot: CheckedRobot) -> Iterator[Rows]:
    """Open the UART, listen for heartbeats, and close it, unless a gateway holds it."""
    path, name = robot.settings.controller.uart, Path(robot.settings.controller.uart).resolve().name
    if not robot.settings.wire.has_uart:
        return
    here = ", ".join(sorted(map(str, Path("/dev").glob(f"{_ALLOWED}*")))) or "none"
    absent = f"switch it on and reboot: sudo hexapod-gateway setup --wire {WITH_UART}; or set controller.uart"
    if not machine.computer(robot.root).startswith(_PI_5):
        absent = ("switch a UART of 1 152 000 baud on as this computer wants it (a Raspberry Pi: an overlay in "
                  f"config.txt), reboot, and set controller.uart to its node; here there is {here}")  # fmt: skip
    free = f"free it, and reboot: sudo hexapod-gateway setup --wire {WITH_UART}"
    console = name in text(robot.path("/sys/class/tty/console/active")).split()
    login = robot.shown(f"serial-getty@{name}.service").get("ActiveState") == "active"
    rows = [
        *_node_faults(robot, path, "dialout", absent),
        failure(console, f"{path} is the Linux console: the kernel's messages go to the controller", free),
        failure(login, f"{path} has a login terminal, which takes the controller's bytes", free),
    ]
    if any(rows) or robot.gateway_runs:
        yield [*rows, well(f"{path} is the running gateway's, which reports whether the controller answers")]
        return
    try:
        with closing(SerialUart(path)) as line:
            yield [
                warning(robot.service and not name.startswith(_ALLOWED),
                        f"{path} opens, but the unit lets the service open {_ALLOWED}… only",
                        "sudo systemctl edit hexapod-gateway, with [Service] "
                        f"DeviceAllow=char-{name.rstrip('0123456789')} rw"),
                well(f"{path} opens, as {_name(pwd.getpwuid, os.geteuid())}"),
            ]  # fmt: skip
            yield [heartbeat(line.read, round(robot.settings.controller.silent_ms * NS_PER_MS))]
    except SpiError as error:
        held = isinstance(error.__cause__, OSError) and error.__cause__.errno in (errno.EAGAIN, errno.EBUSY)
        yield [
            failure(held, f"{path} is held by another program", f"find and end that program: sudo fuser -v {path}"),
            failure(error, str(error), f"is {path} a UART? see dmesg"),
        ]


def heartbeat(
    read: Callable[[], bytes],
    silent_ns: int,
    clock: Callable[[], int] = time.monotonic_ns,
    pause: Callable[[float], None] = time.sleep,
) -> Row:
    """Return the row of the heartbeats that arrive within `silent_ns`."""
    heartbeats, beats, count, until_ns = Heartbeats(), 0, 0, clock() + silent_ns
    while clock() < until_ns:
        pause(_CYCLE_S)
        data = read()
        count += len(data)
        beats += heartbeats.feed(data)
    ms = silent_ns // NS_PER_MS
    return well(f"{beats} heartbeats came in {ms} ms, so the controller speaks {WITH_UART}") if beats else failure(
        True, f"no heartbeat came in {ms} ms, but {count} other bytes",
        "see that the controller has power, that its TX leads to the Pi's RX, and both have the same ground; a "
        f'controller of HexapodProtocol v1.0.0 needs wire.name = "{FRAMED}"',
    )  # fmt: skip


# ---- the power board


def _board(robot: CheckedRobot) -> Iterator[Rows]:
    """Query the power board, unless it is the gateway's."""
    power, rows = robot.settings.power, Rows()
    path, where = power.channel, f"{power.interface} {power.channel}"
    absent = "plug the adapter in or load its driver, or set power.channel (see dmesg, ip link)"
    if power.interface == "slcan":
        rows = _node_faults(robot, path, "dialout", absent)
    elif power.interface == "socketcan":  # everybody may use it, but only root can switch it on
        folder = robot.path(f"/sys/class/net/{path}")
        kind, is_off = text(folder / "type"), not int(text(folder / "flags") or "0", 16) & 1
        rows = [
            failure(not kind, f"{path} is no network interface", absent),
            failure(kind != _CAN, f"{path} is no CAN interface", absent),
            failure(is_off, f"{path} is switched off",  # now and at each boot
                    f"printf '[Match]\\nName={path}\\n[CAN]\\nBitRate={BITRATE}\\nRestartSec=100ms\\n' | sudo tee "
                    f"/etc/systemd/network/80-{path}.network && sudo systemctl enable systemd-networkd && "
                    "sudo systemctl restart systemd-networkd"),
        ]  # fmt: skip
    elif power.interface == "sim":
        rows = [warning(path, "is simulated: no servo loses its supply", 'set power.interface; "" is none')]
    if robot.gateway_runs and not any(rows):
        rows = [well(f"{where} is the running gateway's; `status` shows whether the board answers")]
    if any(rows) or not power.interface:
        yield rows
        return
    try:
        with open_bus(power) as bus:
            supply_mv = next(_supply_mv(bus, power), None)
    except Exception as error:  # also of any of python-can's interfaces
        named = error if isinstance(error, GatewayError) else f"{where}: {error}"
        yield [failure(error, str(named), "see dmesg, and the settings of [power]")]
        return
    yield [
        failure(supply_mv is None, f"{where} opens, and the board does not answer",
                "press its power button (in standby it is silent); see that CAN-H and CAN-L lead to it, with a "
                "resistor of 120 Ω at each end, and that the interface has its bit rate, 1 Mbit/s"),
        well(f"answers on {where}: supply {(supply_mv or 0) / 1e3:.1f} V"),
    ]  # fmt: skip


def _supply_mv(bus: "can.BusABC", settings: PowerSettings) -> Iterator[int]:
    """Ask for the supply's voltage until the board answers."""
    for _ in range(_ROUNDS):
        send(bus, power_board.CanFrame(power_board.SUPPLY_BATTERY_MV), _ROUND_S)
        end_s = time.monotonic() + _ROUND_S
        while (left_s := end_s - time.monotonic()) > 0:
            message = bus.recv(left_s)
            frame = None if message is None else received(message, settings)
            read = None if frame is None else power_board.read(frame)
            if isinstance(read, power_board.Rails):
                yield read.values[0]


DEVICE: Final[Probes] = {"SPI device": _device}
POWER: Final[Probes] = {"power board": _board}
PROBES: Final[Probes] = {
    "wire": _plugin, **DEVICE, "SPI controller": _carrier, "SPI bus": _neighbours, "SPI speed": _speed,
    "UART": _uart, "framing": _framing, "SPI lists": _lists, "calibration": _calibration,
}  # fmt: skip
