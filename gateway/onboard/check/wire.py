"""Probes of the way to the servos: SPI device, bus and clock, framing, calibration, the controller's UART, power board.

Nothing is written to the robot. The published firmware of HexapodProtocol v1.0.0 reads the first byte of an 80-byte
frame as a length of 126, and then ignores Stops until its reset. While a gateway runs, UART and board are not opened:
they belong to the gateway, which reports whether controller and board answer.
"""

import errno
import os
import stat
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Final

from gateway.host import effective
from gateway.host.directories import state_to_read
from gateway.model.elkapod import FRAME_BYTES
from gateway.model.frames import ONE_LEG_LEN, Framing
from gateway.onboard import computer
from gateway.onboard.check.table import RESTART, SERVICE, CheckedRobot, Result, Row, failure, first, held, warning, well
from gateway.robot.power.interface import BITRATE, open_bus
from gateway.robot.runtime.calibrations import CALIBRATION_FILE, load
from gateway.robot.spi import outside
from gateway.robot.spi.bus import CS_CHANGE_NS
from gateway.robot.spi.kernel import NO_SPIDEV, KernelDevice, spidev_module
from gateway.robot.spi.plugin import PluginDevice
from gateway.robot.spi.uart import SerialUart
from gateway.words.own_command import command
from schemas.robot import LEGS

_SLOW_MS: Final = 20.0
"""Six Stops should not take longer than the shortest watchdog timeout, nor an 80-byte frame than its cycle."""
_ALLOWED: Final = "ttyAMA"
"""The unit's DeviceAllow=: the kernel's name of a Raspberry Pi's PL011 UARTs."""
_DROP_INS: Final = f"/etc/systemd/system/{SERVICE}.service.d"
_READERS: Final = ("ModemManager", "brltty")
_IGNORED: Final = "E:ID_MM_DEVICE_IGNORE=1"
"""In udev's data of a device: ModemManager leaves it alone (deploy/udev)."""
_CAN: Final = "280"
"""ARPHRD_CAN, in /sys/class/net/…/type."""


# fmt: off
def _node_faults(robot: CheckedRobot, path: str, group: str, absent: str) -> list[Row]:
    """Return the faults of a device node that belongs to `group` with the package. `absent`: the remedy without it."""
    try:
        mode = os.stat(path).st_mode
    except OSError as error:
        return [failure(error, f"{path}: {error.strerror}", absent)]
    denied = not os.access(path, os.R_OK | os.W_OK)
    may_not = f"{path} may not be opened by this user ({stat.filemode(mode)})"
    return [
        failure(not stat.S_ISCHR(mode), f"{path} is no device node", absent),
        failure(denied and robot.service, may_not, f"sudo chgrp {group} {path} && sudo chmod 660 {path} && {RESTART}"),
        failure(denied, may_not, f"until the next boot: sudo chown $USER {path}"),
    ]


def _opened(
    robot: CheckedRobot, name: str, what: str, attempt: Callable[[], None], remedy: str, *more: Row,
    rows: Sequence[Row] = (), opens: str = "opens",
) -> Result | None:
    """Open and close a device as the service does, unless a gateway has it, or one of `rows` applies."""
    error: Exception | None = None
    runs = robot.gateway_runs
    try:
        if not (runs or any(rows)):
            attempt()
    except Exception as raised:  # also of any of python-can's interfaces
        error = raised
    cause = error and what.startswith("/") and error.__cause__
    busy = isinstance(cause, OSError) and cause.errno in (errno.EAGAIN, errno.EBUSY)
    return first(name,
        *rows,
        held(what, robot.others(robot.open_files.holders(what))) if runs or busy else None,
        well(f"{what} is the running gateway's") if runs else None,
        failure(busy, f"{what} is held by another program", "this names it: sudo hexapod-gateway check"),
        failure(error, str(error), remedy),
        *more,
        well(f"{what} {opens}"))


def _other_readers(robot: CheckedRobot, path: str) -> Result | None:
    """Return a warning of a program that reads from each serial device that appears, and so takes its first answers."""
    with suppress(OSError):
        number = os.stat(path).st_rdev
        data = robot.text(f"/run/udev/data/c{os.major(number)}:{os.minor(number)}")
        ignored = {"ModemManager"} if _IGNORED in data.splitlines() else set[str]()
        active = {each for each in _READERS if robot.shown(f"{each}.service").get("ActiveState") == "active"}
        programs = " ".join(sorted(active - ignored))
        return first("serial",
            warning(programs, f"{programs} may read from {path} whenever it appears; the gateway then misses answers, "
                    "and stops legs", f"if nothing else needs it: sudo systemctl disable --now {programs}"))
    return None


# ---- SPI, or a plug-in


def plugin(robot: CheckedRobot) -> Iterator[Result | None]:
    wire = robot.settings.wire
    if wire.built_in is None:
        robot.gateway_runs = effective.running() is not None
        device = partial(PluginDevice, wire.name, wire.plugin, exclusive=False)
        yield _opened(robot, "wire", wire.name, lambda: device().close(), "read what the plug-in needs, and "
                      "fix [wire] of the configuration")


def spi_bus(robot: CheckedRobot) -> Iterator[Result | None]:
    """The SPI device, its controller and kernel, other devices on the bus, and the clock."""
    spi, protocol, root = robot.settings.spi, robot.settings.wire.built_in, robot.root
    if protocol is None:
        return
    others = ", ".join(sorted(map(str, Path(spi.device).parent.glob("spidev*"))))
    absent = "without a robot: run --sim; else switch SPI on and reboot: sudo hexapod-gateway setup"
    rows = _node_faults(robot, spi.device, "spi", f"set spi.device; this machine has {others}" if others else absent)
    device = partial(KernelDevice, spi.device, spi.speed_hz, mode=protocol.spi_mode)
    with suppress(OSError):  # it does not open, which the line reports
        robot.gateway_runs = not any(rows) and outside.is_gateways(spi.device)
    yield _opened(robot, "SPI device", spi.device, lambda: device().close(), f"is {spi.device} a SPI device? see dmesg",
                  rows=rows, opens="opens" if spidev_module() else f"opens; {NO_SPIDEV}")
    release, built = computer.kernel(root)
    selects = {True: "chip select is a GPIO", False: "the controller drives chip select", None: ""}
    named = (computer.computer(root), release and f"Linux {release}", computer.driver_of(spi.device, root),
             selects[computer.gpio_selects(spi.device, root)])
    found = ", ".join(filter(None, named)) or "nothing is known of it"
    loses = computer.on_rp1(spi.device, root) and (built is None or built < computer.RP1_FIXED)
    yield first("SPI controller",
        warning(loses, f"{found}: a kernel of {built or 'an unknown time'}. Before February 2025 this driver lost "
                "clock edges of transfers that only send; then the controller receives nothing until it is reset",
                "update the kernel: sudo apt update && sudo apt full-upgrade && sudo reboot"),
        well(found))
    others = ", ".join(f"{each} (driver {driver})" for each, driver in computer.neighbours(spi.device, root))
    yield first("SPI bus",  # a neighbour's transfer of 2 ms is what docs/safety.md allows
        warning(others, f"shared with {others}: an emergency stop waits for two to four of its transfers",
                "move it to another bus, or limit its transfers to 2 ms each"),
        well("no other driver uses it"))
    transfers = 1 + (spi.framing is Framing.LENGTH_PREFIXED)
    bits, pause_ms = 8 * (ONE_LEG_LEN + transfers - 1), transfers * (spi.frame_gap_us / 1e3 + CS_CHANGE_NS / 1e6)
    what, takes_ms = "an emergency stop", len(LEGS) * (bits / spi.speed_hz * 1e3 + pause_ms)
    if robot.settings.wire.has_uart:  # Stops do not go over SPI
        what, takes_ms = "a frame", 8 * FRAME_BYTES / spi.speed_hz * 1e3
    takes, known = f"{spi.speed_hz / 1e6:g} MHz; {what} takes {takes_ms:.1f} ms to write", protocol.speed_hz
    yield first("SPI speed",
        warning(spi.speed_hz > known or takes_ms > _SLOW_MS, f"{takes}, and the protocol was measured up to "
                f"{known / 1e6:g} MHz", f"set spi.speed_hz = {known}, or measure a higher clock on your wires"),
        well(takes))


def framing(robot: CheckedRobot) -> Iterator[Result | None]:
    """The framing, and whether the driver is known to release chip select between the transfers of a call."""
    spi, driver = robot.settings.spi, computer.driver_of(robot.settings.spi.device, robot.root) or "this driver"
    if robot.settings.wire.framed:
        yield first("framing",
            warning(spi.framing is Framing.PLAIN, "plain, as in the protocol document; with it the published STM32 "
                    "firmware hangs until its reset",
                    'set spi.framing = "length-prefixed" for that firmware, and reset it'),
            well(f"{spi.framing}, as the published STM32 firmware wants it"))
        releases = spi.framing is not Framing.PLAIN or computer.gpio_selects(spi.device, robot.root)
        yield first("SPI lists",
            warning(not releases, f"it is unknown whether {driver} releases chip select between the "
                    f"transfers of a call", f"{command('check --move')} shows it: if servo 61 still holds when all "
                    f"are stopped, {computer.SELECT_BY_GPIO}"),
            well("the controller reads each frame of a call"))


def calibration(robot: CheckedRobot) -> Iterator[Result | None]:
    """The calibration. Without a usable one the service starts, but moves nothing."""
    folder = state_to_read(robot.settings.state.path)
    if folder is None:
        yield first("calibration", well("is kept in memory only, until the gateway ends (state.path)"))
    else:
        path = folder / CALIBRATION_FILE
        (found, fault), denied = load(path), not os.access(folder, os.X_OK)
        yield first("calibration",
            warning(fault and denied, f"you may not read {path}", "sudo hexapod-gateway check"),
            failure(fault, f"{fault}; nothing can be started",
                    f"restore a good file and restart, or import one, or accept the default: {command('calibrate')}"),
            well(f"revision {found.revision}, servos that differ: {len(found.servos)} ({path})"))


# ---- the UART


def uart(robot: CheckedRobot) -> Iterator[Result | None]:
    path, name = robot.settings.controller.uart, Path(robot.settings.controller.uart).resolve().name
    if not robot.settings.wire.has_uart:
        return
    here = ", ".join(sorted(map(str, Path("/dev").glob(f"{_ALLOWED}*")))) or "none"
    setup = f"sudo hexapod-gateway setup --wire {robot.settings.wire.name}"
    console = name in robot.text("/sys/class/tty/console/active").split()
    login = robot.shown(f"serial-getty@{name}.service").get("ActiveState") == "active"
    rows = [
        *_node_faults(robot, path, "dialout", f"set controller.uart (here there is {here}), or switch it on and "
                      f"reboot: {setup}"),
        failure(console or login, f"{path} has Linux's console or a login, which disturb the controller",
                f"free it, and reboot: {setup}"),
    ]
    yield _opened(robot, "UART", path, lambda: SerialUart(path).close(), f"is {path} a UART? see dmesg",
        warning(robot.service and not name.startswith(_ALLOWED), f"{path} opens, but the unit lets the service open "
                f"{_ALLOWED}… only", f"sudo mkdir -p {_DROP_INS} && sudo tee {_DROP_INS}/uart.conf <<<$"
                f"'[Service]\\nDeviceAllow=char-{name.rstrip('0123456789')} rw' && sudo systemctl daemon-reload && "
                f"{RESTART}"), rows=rows)
    yield _other_readers(robot, path)


# ---- the power board


def power(robot: CheckedRobot) -> Iterator[Result | None]:
    settings, rows = robot.settings.power, list[Row]()
    path, absent = settings.channel, "plug the adapter in or load its driver, or set power.channel (see dmesg, ip link)"
    if not settings.interface:
        return
    if settings.interface == "slcan":
        rows = _node_faults(robot, path, "dialout", absent)
        yield _other_readers(robot, path)
    elif settings.interface == "socketcan":  # everybody may use it, but only root can switch it on
        kind, flags = (robot.text(f"/sys/class/net/{path}/{each}") for each in ("type", "flags"))
        rows = [
            failure(kind != _CAN, f"{path} is no CAN interface", absent),
            failure(not int(flags or "0", 16) & 1, f"{path} is switched off",  # now and at each boot
                    f"sudo tee /etc/systemd/network/80-{path}.network <<<$'[Match]\\nName={path}\\n[CAN]\\nBitRate="
                    f"{BITRATE}\\nRestartSec=100ms' && sudo systemctl enable systemd-networkd && "
                    "sudo systemctl restart systemd-networkd"),
        ]
    elif settings.interface == "sim":
        rows = [failure("--sim" not in robot.unit.get("Environment", ""), "is simulated: no servo loses its supply",
                        'set power.interface; "" is none')]
    yield _opened(robot, "power board", path, lambda: open_bus(settings).shutdown(), "see dmesg, and the "
                  "settings of [power]", rows=rows, opens="opens; `status` shows whether the board answers")


# fmt: on
PROBES: Final = (plugin, spi_bus, uart, framing, calibration)
