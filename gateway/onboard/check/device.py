"""The SPI device, its bus, its clock and framing, and the calibration. Writes nothing to the robot."""

import fcntl
import grp
import os
import pwd
import stat
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Final

from gateway.durable import staged_for
from gateway.errors import SpiError
from gateway.model.angle_limits import AngleLimits
from gateway.model.calibration import RobotCalibration
from gateway.model.elkapod import FRAME_BYTES
from gateway.model.frames import ONE_LEG_LEN, centidegrees
from gateway.model.framing import Framing
from gateway.onboard.check import service_user
from gateway.onboard.check.table import INSTALL, RESTART, CheckedRobot, Fault, Probe, Seen, always, failure, warning
from gateway.robot.core.calibrating import ACCEPT_DEFAULT
from gateway.robot.host.calibration_file import SLOW_S, load, path_to_read
from gateway.robot.sections import SpiSettings
from gateway.robot.spi import ioctls, machine
from gateway.robot.spi.bus import CS_CHANGE_NS
from gateway.robot.spi.kernel import KernelDevice
from schemas.robot import LEGS

SLOW_STOPS_MS: Final = 20.0
"""Six Stops should not take longer to write than the shortest watchdog timeout that can be set; nor should a frame of
elkapod-2025 than its default cycle."""
_READ_SPEED: Final = 2 << 30 | 4 << 16 | ord("k") << 8 | 4
"""SPI_IOC_RD_MAX_SPEED_HZ."""


# ---- nodes


def node(path: str) -> Seen:
    """A device node. `lack`: why it is none, `denied`: this user cannot open it; nothing is known against others."""
    seen = Seen(path=path, lack="", denied=False, rights="", group=None, user=_name(pwd.getpwuid, os.geteuid()))
    seen.service = service_user.uid() is not None
    try:
        status = os.stat(path)
    except OSError as error:
        absent = isinstance(error, FileNotFoundError)
        seen.lack = "does not exist" if absent else f"cannot be looked at ({error.strerror})"
        return seen
    group = _name(grp.getgrgid, status.st_gid)
    seen.rights = f"{stat.filemode(status.st_mode)}, group {group}"
    seen.group = group if status.st_gid and status.st_mode & 0o060 == 0o060 else None
    seen.lack = "" if stat.S_ISCHR(status.st_mode) else "is no device node"
    seen.denied = not seen.lack and not os.access(path, os.R_OK | os.W_OK)
    return seen


def _name(find: Callable[[int], tuple[object, ...]], number: int) -> str:
    """Of a user or a group; their number where they have none."""
    with suppress(KeyError):
        return str(find(number)[0])
    return str(number)


NO_NODE: Final = failure(lambda r: r.lack, "{path} {lack}", "{absent}")
"""The reading has a remedy, `absent`."""


def denied(when: Callable[[Seen], object], remedy: str) -> Fault:
    """A node that this user may not open, where `when` holds, too."""
    return failure(lambda r: r.denied and when(r), "{path} may not be opened by {user} ({rights})", remedy)


JOIN_GROUP: Final = "sudo usermod -aG {group} {user} # then log in again"


# ---- the device


def _device(robot: CheckedRobot) -> Iterator[Seen]:
    """Set it up as the service does it, and close it at once."""
    spi = robot.settings.spi
    seen, path = node(spi.device), Path(spi.device)
    seen.error, seen.opens = "", f"opens, as {seen.user}"
    others = ", ".join(sorted(map(str, path.parent.glob("spidev*"))))
    seen.absent = "switch SPI on (dtparam=spi=on in config.txt) and reboot; without a robot: run --sim"
    seen.absent = f"set spi.device; here there is {others}" if others else seen.absent
    robot.gateway_runs = False
    if not (seen.lack or seen.denied):
        try:
            KernelDevice(spi.device, spi.speed_hz, mode=spi.protocol.spi_mode).close()
        except SpiError as error:
            robot.gateway_runs = isinstance(error.__cause__, BlockingIOError)
            seen.error = "" if robot.gateway_runs else str(error)
        seen.opens += f"; {ioctls.USED}" if ioctls.are_used() else ""
    if robot.gateway_runs:
        seen.opens = "is held by a running gateway; a second one would be rejected"
    yield seen


def _carrier(robot: CheckedRobot) -> Iterator[Seen]:
    """Computer, kernel, driver and chip select; and whether this kernel loses clock edges."""
    device, root = robot.settings.spi.device, robot.root
    release, built = machine.kernel(root)
    parts = [
        machine.computer(root) or "a computer without a device tree",
        f"Linux {release or 'of unknown release'}",
        f"driver {machine.driver_of(device, root) or 'unknown'}",
        {True: "chip select is a GPIO", False: "the controller drives chip select", None: ""}[
            machine.gpio_selects(device, root)
        ],
    ]
    yield Seen(
        found=", ".join(part for part in parts if part),
        when="that was built at an unknown time" if built is None else f"of {built}",
        loses=machine.on_rp1(device, root) and (built is None or built < machine.RP1_FIXED),
    )


def _neighbours(robot: CheckedRobot) -> Iterator[Seen]:
    found = machine.neighbours(robot.settings.spi.device, robot.root)
    yield Seen(others=", ".join(f"{each} (driver {driver})" for each, driver in found))


def kernel_hz(path: str) -> int | None:
    """The clock that the kernel gives the device where nobody has set one: what device tree and controller allow.

    While another program has the device open it is what that one has set.
    """
    try:
        fd = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NONBLOCK)
        try:
            return int.from_bytes(fcntl.ioctl(fd, _READ_SPEED, bytes(4)), sys.byteorder) or None
        finally:
            os.close(fd)
    except OSError:
        return None


def wire_ms(spi: SpiSettings, speed_hz: int) -> float:
    """How long six Stops take on the wire; where these do not go over SPI, a frame."""
    if spi.protocol.measures:
        return 8 * FRAME_BYTES / speed_hz * 1e3
    announced = spi.framing is Framing.LENGTH_PREFIXED
    each_ns = spi.frame_gap_us * 1e3 + CS_CHANGE_NS
    bits = 8 * (ONE_LEG_LEN + announced)
    return len(LEGS) * (bits / speed_hz * 1e3 + (1 + announced) * each_ns / 1e6)


def speed(robot: CheckedRobot, given_hz: int | None) -> Seen:
    """The clock that is set, and that which the protocol and the kernel (with the device tree) allow."""
    spi, known_hz, runs = robot.settings.spi, robot.settings.spi.protocol.speed_hz, robot.gateway_runs
    differs = given_hz is not None and (given_hz != spi.speed_hz if runs else given_hz < spi.speed_hz)
    slowest_hz = min(spi.speed_hz, given_hz or spi.speed_hz)
    takes_ms = wire_ms(spi, slowest_hz)
    return Seen(
        hz=spi.speed_hz, known_hz=known_hz, differs=differs, takes_ms=takes_ms,
        set=_megahertz(spi.speed_hz), known=_megahertz(known_hz), kernel=_megahertz(given_hz or 0),
        takes=f"{'a frame' if spi.protocol.measures else 'an emergency stop'} takes {takes_ms:.1f} ms to write",
        given=f", and the kernel gives {_megahertz(slowest_hz)}" if given_hz is not None else "",
        fix="sudo systemctl restart hexapod-gateway" if runs else f"set spi.speed_hz = {given_hz} or less",
    )  # fmt: skip


def _speed(robot: CheckedRobot) -> Iterator[Seen]:
    yield speed(robot, kernel_hz(robot.settings.spi.device))


def _megahertz(hz: int) -> str:
    return f"{hz / 1e6:g} MHz" if hz >= 10_000 else f"{hz} Hz"


def _framing(robot: CheckedRobot) -> Iterator[Seen]:
    framing = robot.settings.spi.framing
    if not robot.settings.spi.protocol.measures:
        low, high = robot.settings.spi.avoid_cdeg or (0, 0)
        yield Seen(framing=framing, wants=framing.controller, low=low / 100, high=high / 100)


def _lists(robot: CheckedRobot) -> Iterator[Seen]:
    """Whether chip select is known to be released between transfers of one call, as a plain controller needs."""
    spi = robot.settings.spi
    if not spi.protocol.measures:
        driver = machine.driver_of(spi.device, robot.root) or "this driver"
        gpio = machine.gpio_selects(spi.device, robot.root)
        how = f"{driver} may keep chip select within a call; {spi.framing.controller} ignores it"
        released = "chip select is a GPIO, which Linux releases between the transfers of a call"
        yield Seen(how=released if gpio else how, driver=driver, unseen=not gpio and spi.framing.needs_chip_select)


# ---- the calibration


def _kept(robot: CheckedRobot) -> tuple[Path | None, bool, RobotCalibration, str | None]:
    """Where it is, whether this user may not look there, and what is there."""
    path = path_to_read(robot.settings)
    hidden = path is not None and path.parent.exists() and not os.access(path.parent, os.X_OK)
    return (path, hidden, *((RobotCalibration(), None) if path is None or hidden else load(path)))


def _calibration(robot: CheckedRobot) -> Iterator[Seen]:
    """Without one that can be used, the service starts, and moves nothing."""
    path, hidden, found, fault = _kept(robot)
    seen = Seen(path=path, fault=fault, late_at="", hidden=hidden, revision=found.revision)
    seen.which = "is kept in memory only, until the gateway ends (state.path)"
    if path is not None:
        with suppress(OSError):  # a change that was begun to be written, and not ended
            begun_s = staged_for(path).lstat().st_mtime
            if time.time() - begun_s > SLOW_S:
                seen.late_at = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(begun_s))
        seen.which = f"revision {found.revision}, servos that differ: {len(found.servos)} ({path})"
    yield seen


def _landing(robot: CheckedRobot) -> Iterator[Seen]:
    """Each angle of the landing pose, where there is one and the calibration can be used."""
    settings, (_, hidden, found, fault) = robot.settings, _kept(robot)
    if hidden or fault is not None or not settings.watchdog.landing_ms:
        return
    pose = {int(servo): centidegrees(angle) for servo, angle in settings.watchdog.landing.items()}
    why_not = partial(AngleLimits(avoid_cdeg=settings.spi.avoid_cdeg).why_avoided, found)
    for servo_id, angle_cdeg in sorted({**pose, **found.landing_cdeg}.items()):
        yield Seen(why=why_not(servo_id, angle_cdeg))


# fmt: off
DEVICE: Final = Probe("SPI device", _device, (
    NO_NODE,
    denied(lambda r: r.service, "the udev rule of the installation gives it to the group spi at each boot; now: "
           f"sudo chgrp spi {{path}} && sudo chmod 660 {{path}} && {RESTART}"),
    denied(lambda r: r.group, JOIN_GROUP),
    denied(always, f"install the udev rule ({INSTALL}), which gives it to the group spi"),
    failure(lambda r: r.error, "{error}", "is {path} a SPI device? see dmesg"),
), "{path} {opens}")
BUS: Final = (
    Probe("SPI controller", _carrier, (
        warning(lambda r: r.loses, "{found}: a kernel {when}, and before February 2025 this driver lost clock edges of "
                "transfers that only send; the controller then takes in nothing until it is reset",
                "update the kernel (sudo apt full-upgrade) and reboot"),
    ), "{found}"),
    Probe("SPI bus", _neighbours, (
        # A neighbour's transfer of 2 ms is what docs/safety.md allows.
        warning(lambda r: r.others, "on it, too: {others}: an emergency stop waits for two to four of its transfers",
                "move it to another bus, or see that none of its transfers takes more than 2 ms"),
    ), "no other driver uses it"),
    Probe("SPI speed", _speed, (
        warning(lambda r: r.hz > r.known_hz, "{set} is above the {known} up to which the protocol was measured",
                "set spi.speed_hz = {known_hz} or less, or measure the clock on your wires"),
        warning(lambda r: r.differs, "{set} is set, and the kernel gives {kernel}: another program has set it, or the "
                "controller takes no more, or the configuration was changed since; {takes}", "{fix}"),
        warning(lambda r: r.takes_ms > SLOW_STOPS_MS, "{set} is slow: {takes}", "set spi.speed_hz = {known_hz}"),
    ), "{set}{given}; {takes}"),
)
FRAMES: Final = (
    Probe("framing", _framing, (
        warning(lambda r: r.framing is Framing.PLAIN,
                "plain, as in the protocol's document; the published STM32 firmware jams in it until it is reset",
                'set spi.framing = "length-prefixed" for that firmware, and reset it'),
    ), "{framing}, as {wants} wants it; wire angles from {low:g} up to {high:g} degrees are never sent"),
    Probe("SPI lists", _lists, (
        warning(lambda r: r.unseen, "nobody has seen whether {driver} releases chip select between the transfers of a "
                "call", "{run[check --move]} shows it: if servo 61 still holds when all are stopped, "
                f"{machine.SELECT_BY_GPIO}"),
    ), "{how}"),
)
CALIBRATION: Final = (
    Probe("calibration", _calibration, (
        warning(lambda r: r.hidden, "{path} is not for you to read", "sudo hexapod-gateway check"),
        failure(lambda r: r.fault, "{fault}; nothing can be started",
                f"put a good one in its place and restart, or, if the robot is as drawn: {{run[{ACCEPT_DEFAULT}]}}"),
        warning(lambda r: r.late_at, "a change of {late_at} was not kept, and revision {revision} is ({path})",
                "if the gateway runs, its disk hangs (dmesg): restart it once that is fixed; else nothing is wrong"),
    ), "{which}"),
    Probe("landing pose", _landing, (
        warning(lambda r: r.why, "{why}; in a landing it holds its angle", "choose another angle: watchdog.landing in "
                "the configuration, or {run[calibrate landing]}"),
    )),
)
# fmt: on
