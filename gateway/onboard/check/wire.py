"""Probes of the way to the servos: SPI device, bus and clock, framing, calibration, the controller's UART, power board.

Nothing is written to the robot. The published firmware of HexapodProtocol v1.0.0 reads the first byte of an 80-byte
frame as a length of 126, and then ignores Stops until its reset. A power board is only queried. While a gateway runs,
UART and board are not read: they belong to the gateway.
"""

import errno
import fcntl
import grp
import os
import pwd
import re
import stat
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from gateway.allowance import NS_PER_MS
from gateway.durable import staged_for
from gateway.errors import GatewayError, SpiError
from gateway.host import effective
from gateway.host.settings_table import PowerSettings
from gateway.model import power_board
from gateway.model.elkapod import FRAME_BYTES, Heartbeats
from gateway.model.frames import ONE_LEG_LEN
from gateway.model.framing import Framing
from gateway.model.protocols import FRAMED, WITH_UART
from gateway.onboard.check.table import RESTART, CheckedRobot, Fault, Probe, Seen, failure, text, warning
from gateway.robot.core.calibrating import ACCEPT_DEFAULT
from gateway.robot.host.calibration_file import SLOW_S, load, path_to_read
from gateway.robot.power.interface import BITRATE, open_bus, received, send
from gateway.robot.spi import ioctls, machine, outside
from gateway.robot.spi.bus import CS_CHANGE_NS
from gateway.robot.spi.kernel import KernelDevice
from gateway.robot.spi.plugin import PluginDevice
from gateway.robot.spi.uart import SerialUart
from schemas.robot import LEGS

if TYPE_CHECKING:
    import can

SLOW_STOPS_MS: Final = 20.0
"""Six Stops should not take longer than the shortest watchdog timeout, nor an 80-byte frame than its cycle."""
_READ_SPEED: Final = 2 << 30 | 4 << 16 | ord("k") << 8 | 4
"""SPI_IOC_RD_MAX_SPEED_HZ."""
_ALLOWED: Final = "ttyAMA"
"""The unit's DeviceAllow=: the kernel's name of a Raspberry Pi's PL011 UARTs."""
_CYCLE_S: Final = 0.02
"""The cycle of the robot's own driver. That driver restarts after 0.1 s without a heartbeat."""
_PI_5: Final = ("Raspberry Pi 5", "Raspberry Pi Compute Module 5")
_ROUNDS, _ROUND_S = 4, 0.1
"""A query to the board may be lost. The board answers within 2 ms."""
_CAN: Final = "280"
"""ARPHRD_CAN, in /sys/class/net/…/type."""


# ---- nodes


def node(robot: CheckedRobot, path: str) -> Seen:
    """Return a reading of a device node. `lack`: why it is none. `denied`: this user cannot open it."""
    seen = Seen(path=path, lack="", denied=False, rights="", group=None, error="", service=robot.service is not None)
    seen.user = _name(pwd.getpwuid, os.geteuid())
    try:
        status = os.stat(path)
    except OSError as error:
        absent = isinstance(error, FileNotFoundError)
        seen.lack = "does not exist" if absent else f"cannot be read ({error.strerror})"
        return seen
    group = _name(grp.getgrgid, status.st_gid)
    seen.rights = f"{stat.filemode(status.st_mode)}, group {group}"
    seen.group = group if status.st_gid and status.st_mode & 0o060 == 0o060 else None
    seen.lack = "" if stat.S_ISCHR(status.st_mode) else "is no device node"
    seen.denied = not seen.lack and not os.access(path, os.R_OK | os.W_OK)
    return seen


def _name(find: Callable[[int], tuple[object, ...]], number: int) -> str:
    """Return the name of a user or group; the number if it has no name."""
    with suppress(KeyError):
        return str(find(number)[0])
    return str(number)


def _node_faults(group: str) -> tuple[Fault, ...]:
    """Return the faults of a node that belongs to `group` with the package. The reading's `absent` is a remedy."""
    may_not, group_has_it = "{user} may not open {path} ({rights})", f"sudo chgrp {group} {{path}}"
    return (
        failure(lambda r: r.lack, "{path} {lack}", "{absent}"),
        failure(lambda r: r.denied and r.service, may_not, f"{group_has_it} && sudo chmod 660 {{path}} && {RESTART}"),
        failure(lambda r: r.denied and r.group, may_not, "sudo usermod -aG {group} {user} # then log in again"),
        failure(lambda r: r.denied, may_not, "until the next boot: sudo chown {user} {path}"),
    )


# ---- SPI


def _locked_by(path: str) -> str:
    """Return the program that has locked a node, from the kernel's list."""
    status = os.stat(path)
    where = rf"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    found = re.search(rf"FLOCK +ADVISORY +WRITE (\d+) {where} ", text(Path("/proc/locks")))
    return f"{text(Path(f'/proc/{found[1]}/comm'))} (process {found[1]})" if found else "another program"


def _device(robot: CheckedRobot) -> Seen | None:
    """Open and set up the device as the service does, and close it at once."""
    spi, protocol = robot.settings.spi, robot.settings.wire.built_in
    if protocol is None:
        return None
    seen, held = node(robot, spi.device), False
    others = ", ".join(sorted(map(str, Path(spi.device).parent.glob("spidev*"))))
    seen.absent = "switch SPI on and reboot: sudo hexapod-gateway setup; without a robot: run --sim"
    seen.absent = f"set spi.device; this machine has {others}" if others else seen.absent
    if not (seen.lack or seen.denied):
        try:
            KernelDevice(spi.device, spi.speed_hz, mode=protocol.spi_mode).close()
        except SpiError as error:
            held = isinstance(error.__cause__, BlockingIOError)
            seen.error = "" if held else str(error)
    robot.gateway_runs = held and outside.is_gateways(spi.device)
    seen.locked = _locked_by(spi.device) if held and not robot.gateway_runs else ""
    seen.opens = f"opens, as {seen.user}" + (f"; {ioctls.USED}" if ioctls.are_used() else "")
    if robot.gateway_runs:
        seen.opens = "is held by a running gateway; a second one would be rejected"
    return seen


def _carrier(robot: CheckedRobot) -> Seen | None:
    """Computer, kernel, driver and chip select, and whether this kernel loses clock edges."""
    if robot.settings.wire.built_in is None:
        return None
    device, root = robot.settings.spi.device, robot.root
    release, built = machine.kernel(root)
    selects = {True: ", chip select is a GPIO", False: ", the controller drives chip select", None: ""}
    found = f"{machine.computer(root) or 'a computer without a device tree'}, Linux {release or 'of unknown release'}, "
    found += f"driver {machine.driver_of(device, root) or 'unknown'}{selects[machine.gpio_selects(device, root)]}"
    old, when = built is None or built < machine.RP1_FIXED, "that was built at an unknown time"
    return Seen(found=found, when=f"of {built}" if built else when, loses=machine.on_rp1(device, root) and old)


def _neighbours(robot: CheckedRobot) -> Seen | None:
    """Read the drivers of other devices on the same bus."""
    if robot.settings.wire.built_in is None:
        return None
    found = machine.neighbours(robot.settings.spi.device, robot.root)
    return Seen(others=", ".join(f"{each} (driver {driver})" for each, driver in found))


def _speed(robot: CheckedRobot) -> Seen | None:
    """Read the clock of the device, compared with the highest that the kernel allows."""
    if robot.settings.wire.built_in is None:
        return None
    with suppress(OSError):
        fd = os.open(robot.settings.spi.device, os.O_RDWR | os.O_CLOEXEC | os.O_NONBLOCK)
        try:
            return speed(robot, int.from_bytes(fcntl.ioctl(fd, _READ_SPEED, bytes(4)), sys.byteorder) or None)
        finally:
            os.close(fd)
    return speed(robot, None)


def speed(robot: CheckedRobot, given_hz: int | None) -> Seen:
    """Return a reading of the clock that is set, and of those that the protocol and the kernel (`given_hz`) allow.

    `takes_ms`: the duration of six Stops on the wire, or of a frame if Stops do not go over SPI.
    """
    spi, runs, protocol = robot.settings.spi, robot.gateway_runs, robot.settings.wire.built_in or FRAMED
    differs = given_hz is not None and (given_hz != spi.speed_hz if runs else given_hz < spi.speed_hz)
    slowest_hz = min(spi.speed_hz, given_hz or spi.speed_hz)
    transfers = 1 + (spi.framing is Framing.LENGTH_PREFIXED)
    bits, pause_ms = 8 * (ONE_LEG_LEN + transfers - 1), transfers * (spi.frame_gap_us / 1e3 + CS_CHANGE_NS / 1e6)
    what, takes_ms = "an emergency stop", len(LEGS) * (bits / slowest_hz * 1e3 + pause_ms)
    if not protocol.framed:
        what, takes_ms = "a frame", 8 * FRAME_BYTES / slowest_hz * 1e3
    return Seen(
        spi=spi, differs=differs, takes_ms=takes_ms, takes=f"{what} takes {takes_ms:.1f} ms to write",
        set=_megahertz(spi.speed_hz), known_hz=protocol.speed_hz, known=_megahertz(protocol.speed_hz),
        kernel=_megahertz(given_hz or 0),
        given=f", and the kernel gives {_megahertz(slowest_hz)}" if given_hz is not None else "",
        fix="sudo systemctl restart hexapod-gateway" if runs else f"set spi.speed_hz = {given_hz} or less",
    )  # fmt: skip


def _megahertz(hz: int) -> str:
    return f"{hz / 1e6:g} MHz" if hz >= 10_000 else f"{hz} Hz"


def _frames(robot: CheckedRobot) -> Seen | None:
    """Read the framing, and whether the driver is known to release chip select between the transfers of a call."""
    spi = robot.settings.spi
    if not robot.settings.wire.framed:
        return None
    driver = machine.driver_of(spi.device, robot.root) or "this driver"
    gpio, (low, high) = machine.gpio_selects(spi.device, robot.root), spi.avoid_cdeg or (0, 0)
    how = f"{driver} may keep chip select within a call; {spi.framing.controller} ignores it"
    how = "chip select is a GPIO, which Linux releases between the transfers of a call" if gpio else how
    unseen = not gpio and spi.framing.needs_chip_select
    return Seen(framing=spi.framing, low=low / 100, high=high / 100, driver=driver, how=how, unseen=unseen)


def _calibration(robot: CheckedRobot) -> Seen:
    """The calibration. Without a usable one the service starts, but moves nothing."""
    seen, path = Seen(hidden=False, fault="", late_at=""), path_to_read(robot.settings)
    seen.which, seen.path = "is kept in memory only, until the gateway ends (state.path)", path
    if path is None:
        return seen
    seen.hidden = path.parent.exists() and not os.access(path.parent, os.X_OK)
    if not seen.hidden:
        found, seen.fault = load(path)
        seen.which = f"revision {found.revision}, servos that differ: {len(found.servos)} ({path})"
        with suppress(OSError):  # a change whose writing has not ended
            begun_s = staged_for(path).lstat().st_mtime
            if time.time() - begun_s > SLOW_S:
                seen.late_at = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(begun_s))
    return seen


# ---- a plug-in


def _plugin(robot: CheckedRobot) -> Seen | None:
    """Open and close the plug-in, unless a gateway holds it."""
    wire = robot.settings.wire
    if wire.built_in is not None:
        return None
    used = effective.read()
    robot.gateway_runs = used is not None and used.runs
    can = [name.replace("_", " ") for name, has in wire.capabilities._asdict().items() if has]
    seen = Seen(name=wire.name, error="", can=f"{type(wire.plugin).__name__}, {', '.join(can) or 'servos one by one'}")
    if not robot.gateway_runs:
        try:
            PluginDevice(wire.name, wire.plugin, exclusive=False).close()
        except SpiError as error:
            seen.error = str(error)
    return seen


# ---- the UART


def _uart(robot: CheckedRobot) -> Seen | None:
    """Open and close the UART, unless a gateway holds it."""
    path, root = robot.settings.controller.uart, robot.root
    if not robot.settings.wire.has_uart:
        return None
    seen, name = node(robot, path), Path(path).resolve().name
    here = ", ".join(sorted(map(str, Path("/dev").glob(f"{_ALLOWED}*")))) or "none"
    seen.absent = _SWITCH_ON if machine.computer(root).startswith(_PI_5) else _NO_PI_5.format(here)
    seen.tty, seen.kind, seen.opens = name, name.rstrip("0123456789"), f"opens, as {seen.user}"
    seen.console, seen.held = name in text(root / "sys/class/tty/console/active").split(), False
    seen.login = robot.shown(f"serial-getty@{name}.service").get("ActiveState") == "active"
    if robot.gateway_runs:
        seen.opens, seen.service = "is the running gateway's, which reports whether the controller answers", False
    elif not (seen.lack or seen.denied or seen.console or seen.login):
        try:
            SerialUart(path).close()
        except SpiError as error:
            cause, seen.error = error.__cause__, str(error)
            seen.held = isinstance(cause, OSError) and cause.errno in (errno.EAGAIN, errno.EBUSY)
    return seen


def _heartbeat(robot: CheckedRobot) -> Seen | None:
    """Listen for heartbeats; nothing while a gateway runs, or if the UART has a fault of its own."""
    seen = _uart(robot)
    if seen is None or robot.gateway_runs or any((seen.lack, seen.denied, seen.console, seen.login, seen.error)):
        return None
    with suppress(SpiError), closing(SerialUart(seen.path)) as line:
        return heartbeat(line.read, round(robot.settings.controller.silent_ms * NS_PER_MS))
    return None


def heartbeat(
    read: Callable[[], bytes],
    silent_ns: int,
    clock: Callable[[], int] = time.monotonic_ns,
    pause: Callable[[float], None] = time.sleep,
) -> Seen:
    """Read the number of heartbeats and of bytes that arrive within `silent_ns`."""
    heartbeats, seen, until_ns = Heartbeats(), Seen(beats=0, bytes=0, ms=silent_ns // NS_PER_MS), clock() + silent_ns
    while clock() < until_ns:
        pause(_CYCLE_S)
        data = read()
        seen.bytes += len(data)
        seen.beats += heartbeats.feed(data)
    return seen


# ---- the power board


def _board(robot: CheckedRobot) -> Seen | None:
    """Read the power board; None if none is configured."""
    power = robot.settings.power
    if not power.interface:
        return None
    seen = node(robot, power.channel) if power.interface == "slcan" else Seen(path=power.channel, lack="", denied=False)
    seen.absent = "plug the adapter in or load its driver, or set power.channel (see dmesg, ip link)"
    seen.where, seen.simulated = f"{power.interface} {power.channel}", power.interface == "sim"
    seen.off, seen.error, seen.silent = False, "", False
    if power.interface == "socketcan":  # everybody may use it, but only root can switch it on
        folder = robot.root / "sys/class/net" / power.channel
        kind = text(folder / "type")
        seen.lack = "" if kind == _CAN else "is no CAN interface" if kind else "is no network interface"
        seen.off = not int(text(folder / "flags") or "0", 16) & 1
    seen.answers = f"{seen.where} is the running gateway's; `status` shows whether the board answers"
    if not (robot.gateway_runs or seen.simulated or seen.lack or seen.denied or seen.off):
        try:
            with open_bus(power) as bus:
                supply_mv = next(_supply_mv(bus, power), None)
            seen.silent = supply_mv is None
            seen.answers = f"answers on {seen.where}: supply {(supply_mv or 0) / 1e3:.1f} V"
        except GatewayError as error:
            seen.error = str(error)
        except Exception as error:  # from any of python-can's interfaces
            seen.error = f"{seen.where}: {error}"
    return seen


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


# ---- the table

_SWITCH_ON: Final = f"switch it on and reboot: sudo hexapod-gateway setup --wire {WITH_UART}; or set controller.uart"
_NO_PI_5: Final = (
    "switch a UART of 1 152 000 baud on as this computer wants it (a Raspberry Pi: an overlay in config.txt), reboot, "
    "and set controller.uart to its node; here there is {}"
)
_OFF: Final = f"free it, and reboot: sudo hexapod-gateway setup --wire {WITH_UART}"
# fmt: off
DEVICE: Final = Probe("SPI device", _device, (
    *_node_faults("spi"),
    failure(lambda r: r.locked, "{path} is locked by {locked}, not by a gateway",
            f"end that program, then: {RESTART}"),
    failure(lambda r: r.error, "{error}", "is {path} a SPI device? see dmesg"),
), "{path} {opens}")
BUS: Final = (
    Probe("SPI controller", _carrier, (
        warning(lambda r: r.loses, "{found}: a kernel {when}. Before February 2025 this driver lost clock edges of "
                "transfers that only send; then the controller receives nothing until it is reset",
                "update the kernel (sudo apt full-upgrade) and reboot"),
    ), "{found}"),
    Probe("SPI bus", _neighbours, (
        # A neighbour's transfer of 2 ms is what docs/safety.md allows.
        warning(lambda r: r.others, "shared with {others}: an emergency stop waits for two to four of its transfers",
                "move it to another bus, or limit its transfers to 2 ms each"),
    ), "no other driver uses it"),
    Probe("SPI speed", _speed, (
        warning(lambda r: r.spi.speed_hz > r.known_hz, "{set} is above {known}, the highest at which the "
                "protocol was measured",
                "set spi.speed_hz = {known_hz} or less, or measure the clock on your wires"),
        warning(lambda r: r.differs, "{set} is set, but the kernel gives {kernel}: another program has set it, or the "
                "controller allows no more, or the configuration was changed since; {takes}", "{fix}"),
        warning(lambda r: r.takes_ms > SLOW_STOPS_MS, "{set} is slow: {takes}",
                "set spi.speed_hz = {known_hz}"),
    ), "{set}{given}; {takes}"),
)
PLUGIN: Final = Probe("wire", _plugin, (
    failure(lambda r: r.error, "{error}", "read what the plug-in needs, and fix [wire] of the configuration"),
), "{name} opens: {can}")
FRAMES: Final = (
    Probe("framing", _frames, (
        warning(lambda r: r.framing is Framing.PLAIN,
                "plain, as in the protocol document; with it the published STM32 firmware hangs until its reset",
                'set spi.framing = "length-prefixed" for that firmware, and reset it'),
    ), "{framing}, as {framing.controller} wants it; wire angles from {low:g} up to {high:g} degrees are never sent"),
    Probe("SPI lists", _frames, (
        warning(lambda r: r.unseen, "it is unknown whether {driver} releases chip select between the transfers of a "
                "call", "{run[check --move]} shows it: if servo 61 still holds when all are stopped, "
                f"{machine.SELECT_BY_GPIO}"),
    ), "{how}"),
)
CALIBRATION: Final = Probe("calibration", _calibration, (
    warning(lambda r: r.hidden, "you may not read {path}", "sudo hexapod-gateway check"),
    failure(lambda r: r.fault, "{fault}; nothing can be started",
            f"restore a good file and restart, or, if the robot is as drawn: {{run[{ACCEPT_DEFAULT}]}}"),
    warning(lambda r: r.late_at, "a change of {late_at} was not kept; the calibration in force: {which}",
            "if the gateway runs, its disk hangs (dmesg): fix that, then restart it; otherwise nothing is wrong"),
), "{which}")
CONTROLLER: Final = (
    Probe("UART", _uart, (
        *_node_faults("dialout"),
        failure(lambda r: r.console, "{path} is the Linux console: the kernel's messages go to the controller", _OFF),
        failure(lambda r: r.login, "{path} has a login terminal, which takes the controller's bytes", _OFF),
        failure(lambda r: r.held, "{path} is held by another program",
                "find and end that program: sudo fuser -v {path}"),
        failure(lambda r: r.error, "{error}", "is {path} a UART? see dmesg"),
        warning(lambda r: r.service and not r.tty.startswith(_ALLOWED),
                f"{{path}} opens, but the unit lets the service open {_ALLOWED}… only",
                "sudo systemctl edit hexapod-gateway, with [Service] DeviceAllow=char-{kind} rw"),
    ), "{path} {opens}"),
    Probe("heartbeat", _heartbeat, (
        failure(lambda r: not r.beats, "none came in {ms} ms, but {bytes} other bytes",
                "see that the controller has power, that its TX leads to the Pi's RX, and both have the same ground; a "
                f'controller of HexapodProtocol v1.0.0 needs wire.name = "{FRAMED}"'),
    ), "{beats} came in {ms} ms, so the controller speaks " + WITH_UART),
)
POWER: Final = Probe("power board", _board, (
    warning(lambda r: r.simulated, "is simulated: no servo loses its supply", 'set power.interface; "" is none'),
    *_node_faults("dialout"),
    failure(lambda r: r.off, "{path} is switched off",  # now and at each boot
            f"printf '[Match]\\nName={{path}}\\n[CAN]\\nBitRate={BITRATE}\\nRestartSec=100ms\\n' | sudo tee "
            "/etc/systemd/network/80-{path}.network && sudo systemctl enable systemd-networkd && "
            "sudo systemctl restart systemd-networkd"),
    failure(lambda r: r.error, "{error}", "see dmesg, and the settings of [power]"),
    failure(lambda r: r.silent, "{where} opens, and the board does not answer",
            "press its power button (in standby it is silent); see that CAN-H and CAN-L lead to it, with a resistor of "
            "120 Ω at each end, and that the interface has its bit rate, 1 Mbit/s"),
), "{answers}")
PROBES: Final = (PLUGIN, DEVICE, *BUS, *CONTROLLER, *FRAMES, CALIBRATION)
# fmt: on
