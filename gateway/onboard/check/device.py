"""The SPI device: node, permissions, who holds it, speed, framing. Writes nothing to the robot."""

import fcntl
import os
import sys
from pathlib import Path
from typing import Final

from gateway.errors import SpiError
from gateway.model.elkapod import FRAME_BYTES
from gateway.model.frames import ONE_LEG_LEN
from gateway.model.framing import Framing
from gateway.onboard.check import nodes, service_user
from gateway.onboard.check.installation import RESTART
from gateway.onboard.check.result import Result, failure, ok, warning
from gateway.own_command import command
from gateway.robot.sections import SpiSettings
from gateway.robot.spi import ioctls
from gateway.robot.spi.bus import CS_CHANGE_NS
from gateway.robot.spi.kernel import KernelDevice
from gateway.robot.spi.machine import ROOT_DIR, SELECT_BY_GPIO, driver_of, gpio_selects
from schemas.robot import LEGS

SLOW_STOPS_MS: Final = 20.0
"""Six Stops should not take longer to write than the shortest watchdog timeout that can be set; nor should a frame of
elkapod-2025 than its default cycle."""

_READ_SPEED: Final = 2 << 30 | 4 << 16 | ord("k") << 8 | 4
"""SPI_IOC_RD_MAX_SPEED_HZ."""
_NAME: Final = "SPI device"
_HELD: Final = "is held by a running gateway"


def device(spi: SpiSettings) -> Result:
    """Whether the device can be opened and set up as the service does it. Closes it at once."""
    path = Path(spi.device)
    lack = nodes.missing(_NAME, path, "spi.device", _absent(path)) or _permission(path)
    if lack is not None:
        return lack
    try:
        KernelDevice(spi.device, spi.speed_hz, mode=spi.protocol.spi_mode).close()
    except SpiError as error:
        if isinstance(error.__cause__, BlockingIOError):
            return ok(_NAME, f"{path} {_HELD}; a second one would be rejected")
        return failure(_NAME, str(error), f"is {path} a SPI device? see dmesg")
    by = f"; {ioctls.USED}" if ioctls.are_used() else ""
    return ok(_NAME, f"{path} opens, as {nodes.user()}{by}")


def held(result: Result) -> bool:
    """Whether `device` found that a gateway holds the device."""
    return _HELD in result.sentence


def _absent(path: Path) -> str:
    others = sorted(str(found) for found in path.parent.glob("spidev*")) if path.parent.is_dir() else []
    return (
        f"set spi.device; here there is {', '.join(others)}"
        if others
        else "switch SPI on (dtparam=spi=on in config.txt) and reboot; without a robot: run --sim"
    )


def _permission(path: Path) -> Result | None:
    if os.access(path, os.R_OK | os.W_OK):
        return None
    group = nodes.group_that_may(path)
    fix = (
        f"the udev rule of the installation gives it to the group spi at each boot; now: sudo chgrp spi {path} && "
        f"sudo chmod 660 {path} && {RESTART}"
        if service_user.uid() is not None
        else f"sudo usermod -aG {group} {nodes.user()} # then log in again"
        if group is not None
        else "install the udev rule (sudo deploy/install.sh), which gives it to the group spi"
    )
    return nodes.denied(_NAME, path, fix)


def kernel_hz(path: str) -> int | None:
    """The clock that the kernel gives the device where nobody has set one: what device tree and controller allow.

    While another program has the device open it is what that one has set. Linux answers with a speed that was set
    even where the controller's limit lowers it, so it is read before.
    """
    try:
        fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
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


def speed(
    spi: SpiSettings, *, kernel_hz: int | None = None, gateway_runs: bool = False, root: Path = ROOT_DIR
) -> Result:
    """The clock, compared with what was measured, what device tree and kernel allow, and how long a Stop may take.

    `kernel_hz`: what the function of that name found, while a gateway had the device open or not (`gateway_runs`).
    """
    name = "SPI speed"
    wanted = _megahertz(spi.speed_hz)
    most_hz = _most_hz(root / "sys/class/spidev" / Path(spi.device).name / "device/of_node/spi-max-frequency")
    if most_hz is not None and spi.speed_hz > most_hz:
        return warning(
            name,
            f"{wanted} is above the {_megahertz(most_hz)} that the device tree allows {spi.device}",
            f"set spi.speed_hz = {most_hz} or less, or raise spi-max-frequency",
        )
    known_hz = spi.protocol.speed_hz
    if spi.speed_hz > known_hz:
        how = "that the robot's own driver has" if spi.protocol.measures else "up to which the protocol was measured"
        return warning(
            name,
            f"{wanted} is above the {_megahertz(known_hz)} {how}",
            f"set spi.speed_hz = {known_hz}, or measure the clock on your wires",
        )
    given_hz = min(spi.speed_hz, kernel_hz or spi.speed_hz)
    takes_ms = wire_ms(spi, given_hz)
    what = "a frame" if spi.protocol.measures else "an emergency stop"
    if kernel_hz is not None and (kernel_hz != spi.speed_hz if gateway_runs else kernel_hz < spi.speed_hz):
        why, fix = _OTHER_SPEED if gateway_runs else (_LOWERED, f"set spi.speed_hz = {kernel_hz} or less")
        return warning(
            name,
            f"{wanted} is set, and the kernel gives {_megahertz(kernel_hz)}: {why}; "
            f"{what} takes {takes_ms:.1f} ms to write",
            fix,
        )
    if takes_ms > SLOW_STOPS_MS:
        return warning(
            name,
            f"{wanted} is so slow that {what} takes {takes_ms:.0f} ms to write",
            f"set spi.speed_hz = {known_hz}",
        )
    given = f", and the kernel gives {_megahertz(given_hz)}" if kernel_hz is not None else ""
    return ok(name, f"{wanted}{given}; {what} takes {takes_ms:.1f} ms to write")


_LOWERED: Final = "its controller takes no more, or another program has the device open"
_OTHER_SPEED: Final = (
    "another program has set it, or the configuration was changed since the gateway was started",
    "sudo systemctl restart hexapod-gateway",
)


def framing(spi: SpiSettings) -> Result:
    """The framing that the controller's firmware must have, too."""
    if spi.framing is Framing.PLAIN:
        return warning(
            "framing",
            "plain, as in the protocol's document; the published STM32 firmware jams in it until it is reset",
            'set spi.framing = "length-prefixed" for that firmware, and reset it',
        )
    low, high = spi.avoid_cdeg or (0, 0)
    avoided = f"{low / 100:g} up to {high / 100:g} degrees are never sent"
    return ok("framing", f"{spi.framing}, as {spi.framing.controller} wants it; wire angles from {avoided}")


def lists(spi: SpiSettings, *, root: Path = ROOT_DIR) -> Result:
    """Whether chip select is known to be released between transfers of one call, as a plain controller needs."""
    name = "SPI lists"
    driver = driver_of(spi.device, root)
    if gpio_selects(spi.device, root):
        return ok(name, "chip select is a GPIO, which Linux releases between the transfers of a call")
    if not spi.framing.needs_chip_select:
        return ok(
            name, f"{driver or 'the driver'} may keep chip select within a call; {spi.framing.controller} ignores it"
        )
    return warning(
        name,
        f"nobody has seen whether {driver or 'this driver'} releases chip select between the transfers of a call",
        f"{command('check --move')} shows it: if servo 61 still holds when all are stopped, {SELECT_BY_GPIO}",
    )


def _most_hz(file: Path) -> int | None:
    """A device tree's number: four bytes, the highest first."""
    try:
        data = file.read_bytes()
    except OSError:
        return None
    return int.from_bytes(data, "big") if len(data) == 4 and any(data) else None


def _megahertz(hz: int) -> str:
    return f"{hz / 1e6:g} MHz" if hz >= 10_000 else f"{hz} Hz"
