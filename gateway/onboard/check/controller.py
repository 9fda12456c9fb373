"""The controller of elkapod-2025: its UART, its heartbeat, its answers.

Until a heartbeat has come, nothing is written: the published firmware of HexapodProtocol v1.0.0 takes a frame's first
byte for a length of 126, which leaves it deaf to Stops until its reset. Nor is anything read while a gateway runs: the
heartbeats are its own. Answers need frames, and each frame has all eighteen angles, so the shutdown goes ahead of them,
as often as a gateway repeats it.
"""

import errno
import os
import re
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.errors import SpiError
from gateway.model import elkapod
from gateway.model.elkapod import SHUTDOWN, Heartbeats, Measured
from gateway.model.protocols import SpiProtocol
from gateway.onboard.check import nodes, service_user
from gateway.onboard.check.result import Result, Verdict, failure, ok, warning
from gateway.robot.protocol.elkapod import FROZEN_NS, SignsOfLife
from gateway.robot.settings import Settings
from gateway.robot.spi import DuplexDevice
from gateway.robot.spi.kernel import KernelDevice
from gateway.robot.spi.machine import ROOT_DIR, computer
from gateway.robot.spi.uart import SerialUart, Uart
from schemas.robot import SERVO_IDS

_NAME: Final = "UART"
_ALLOWED: Final = "ttyAMA"
"""The unit's DeviceAllow=: the kernel's name of a Raspberry Pi's PL011 UARTs."""
_CYCLE_S: Final = 0.02
"""The robot's own driver has this cycle. Heartbeats come within 0.1 s, after which that driver starts again."""
_MIDDLE: Final = elkapod.frame([elkapod.MIDDLE_CDEG] * len(SERVO_IDS))
_NO_POWER: Final = (
    "see that the controller has power, that its TX leads to the Pi's RX, and both have the same ground; a controller "
    'of HexapodProtocol v1.0.0 needs spi.protocol = "hexapod-1.0"'
)


def results(settings: Settings, *, gateway_runs: bool) -> Iterator[Result]:
    """Whether the UART can be used, and a controller of this protocol is at its other end, where no gateway runs."""
    found = uart(settings.controller.uart, gateway_runs=gateway_runs)
    yield found
    if gateway_runs or found.verdict is Verdict.FAILURE:
        return
    try:
        line = SerialUart(settings.controller.uart)
    except SpiError as error:  # taken since
        yield failure(_NAME, str(error), _END_IT)
        return
    spi, watchdog = settings.spi, settings.watchdog
    try:
        yield from talk(
            line,
            lambda: KernelDevice(spi.device, spi.speed_hz, mode=spi.protocol.spi_mode),
            silent_ns=round(settings.controller.silent_ms * NS_PER_MS),
            shutdowns=[watchdog.repeat_interval_ms / 1e3] * (1 + watchdog.repeats),
        )
    finally:
        line.close()


# ---- the UART


def uart(path: str, *, gateway_runs: bool, root: Path = ROOT_DIR) -> Result:
    """Whether it is there, allowed and free. It is opened and closed, unless a gateway holds it."""
    node = Path(path)
    lack = nodes.missing(_NAME, node, "controller.uart", _absent(node, root)) or _permission(node) or _used(node, root)
    if lack is not None:
        return lack
    if gateway_runs:
        return ok(_NAME, f"{path} is the running gateway's, which reports whether the controller answers")
    try:
        SerialUart(path).close()
    except SpiError as error:
        cause = error.__cause__
        if isinstance(cause, OSError) and cause.errno in (errno.EAGAIN, errno.EBUSY):
            return failure(_NAME, f"{path} is held by another program", _END_IT)
        return failure(_NAME, str(error), f"is {path} a UART? see dmesg")
    name = node.resolve().name
    if service_user.uid() is not None and not name.startswith(_ALLOWED):
        kind = name.rstrip("0123456789")
        return warning(
            _NAME,
            f"{path} opens, but the unit lets the service open {_ALLOWED}… only",
            f"sudo systemctl edit hexapod-gateway, with [Service] DeviceAllow=char-{kind} rw",
        )
    return ok(_NAME, f"{path} opens, as {nodes.user()}")


_END_IT: Final = "end that program: sudo fuser -v on the UART names it"


def _absent(node: Path, root: Path) -> str:
    number = re.fullmatch(r"ttyAMA([0-4])", node.name)
    pi_5 = re.match(r"Raspberry Pi (5|Compute Module 5)", computer(root))
    if number is None or pi_5 is None:
        return "switch this UART on as this computer wants it, and reboot; or set controller.uart"
    return (
        f"switch it on (dtoverlay=uart{number[1]}-pi5 in /boot/firmware/config.txt) and reboot; or set controller.uart"
    )


def _permission(node: Path) -> Result | None:
    if os.access(node, os.R_OK | os.W_OK):
        return None
    group = nodes.group_that_may(node)
    fix = (
        f"{node} belongs to root alone: sudo chgrp dialout {node} && sudo chmod 660 {node}"
        if group is None
        else f"sudo usermod -aG {group} {nodes.user()} # then log in again"
        if service_user.uid() is None
        else f"install again with --protocol {SpiProtocol.ELKAPOD_2025}, which lets the service's user be in dialout"
    )
    return nodes.denied(_NAME, node, fix)


def _used(node: Path, root: Path) -> Result | None:
    """By Linux itself: its console, or a login."""
    name = node.resolve().name
    off = (
        f"sudo raspi-config nonint do_serial_cons 1 && sudo systemctl disable --now serial-getty@{name}, see that "
        f"/boot/firmware/cmdline.txt has no console={name}, and reboot"
    )
    if name in _read(root / "sys/class/tty/console/active").split():
        return failure(_NAME, f"{node} is the Linux console: the kernel's messages go to the controller", off)
    for program in _logins(node.stat().st_rdev, root):
        return failure(_NAME, f"{node} is the terminal of {program}, which takes the controller's bytes", off)
    return None


def _logins(rdev: int, root: Path) -> Iterator[str]:
    """The programs whose controlling terminal it is: /proc tells that of everybody's."""
    major, minor = os.major(rdev), os.minor(rdev)
    terminal = str(minor & 0xFF | major << 8 | (minor & ~0xFF) << 12)
    for file in (root / "proc").glob("[0-9]*/stat"):
        head, _, rest = _read(file).rpartition(") ")
        if rest.split()[4:5] == [terminal]:  # state, parent, group, session, terminal
            yield head.partition(" (")[2]


def _read(file: Path) -> str:
    try:
        return file.read_text(errors="replace")
    except OSError:  # of a process that has ended
        return ""


# ---- the controller


def talk(
    line: Uart,
    open_device: Callable[[], DuplexDevice],
    *,
    silent_ns: int,
    shutdowns: Sequence[float],
    clock: Callable[[], int] = time.monotonic_ns,
    pause: Callable[[float], None] = time.sleep,
) -> Iterator[Result]:
    """Listen for a heartbeat; after one, shut down and clock frames, and judge the answers as the gateway does.

    `silent_ns`: how long each may take to come. `shutdowns`: the pause behind each shutdown, in seconds.
    """
    try:
        beats, received = _listened(line, clock() + silent_ns, clock, pause)
    except SpiError as error:
        yield failure("heartbeat", str(error), "see dmesg")
        return
    within = f"in {silent_ns // NS_PER_MS} ms"
    if not beats:
        what = f"{received} bytes came {within}, and no heartbeat among them" if received else f"none came {within}"
        yield failure("heartbeat", f"{what}; so nothing was written to the controller", _NO_POWER)
        return
    yield ok("heartbeat", f"{beats} came {within}, so the controller speaks {SpiProtocol.ELKAPOD_2025}")
    try:
        yield _answers(line, open_device, silent_ns, shutdowns, clock, pause)
    except SpiError as error:
        yield failure("answers", str(error), "see dmesg")


def _listened(line: Uart, until_ns: int, clock: Callable[[], int], pause: Callable[[float], None]) -> tuple[int, int]:
    """How many heartbeats and bytes have come until then."""
    heartbeats, beats, received = Heartbeats(), 0, 0
    while clock() < until_ns:
        pause(_CYCLE_S)
        data = line.read()
        received += len(data)
        beats += heartbeats.feed(data)
    return beats, received


def _answers(
    line: Uart,
    open_device: Callable[[], DuplexDevice],
    silent_ns: int,
    shutdowns: Sequence[float],
    clock: Callable[[], int],
    pause: Callable[[float], None],
) -> Result:
    device = open_device()
    try:
        for pause_s in shutdowns:
            line.write(SHUTDOWN)
            pause(pause_s)
        signs, measured, well, badly = SignsOfLife(silent_ns, clock()), None, 0, 0
        # Long enough that one which freezes falls silent, and that a sensor which measures changes its values.
        until_ns = clock() + silent_ns + FROZEN_NS + round(5e9 * _CYCLE_S)
        while clock() < until_ns:
            measured = signs.answered(device.exchange(_MIDDLE), clock())
            well, badly = (well, badly + 1) if measured is None else (well + 1, badly)
            pause(_CYCLE_S)
            signs.heard(line.read(), clock())
    finally:
        device.close()
    count = f"{well} of {well + badly} are well formed, with all servos shut down"
    if measured is None or not signs.alive(clock()):
        return failure("answers", f"{signs.silent(clock()) or 'the last one is not well formed'}; {count}", _WIRES)
    if badly > 1:  # the first one after power-up may be anything
        return warning("answers", count, _WIRES)
    count += f": {_values(measured)}"
    constant = signs.changes.constant
    if constant:
        count += f"; constant all the time: {', '.join(constant)}"
    if set(constant) >= _NOISY:
        return warning("answers", count, _IMU)
    return ok("answers", count)


_NOISY: Final = frozenset({"angular velocity", "linear acceleration"})
"""Without noise there is no gyroscope and no accelerometer."""
_IMU: Final = (
    "see that the inertial sensor is connected, and that its part of the firmware runs; the robot walks without it, "
    "but safety.max_tilt_deg then sees no fall"
)


_WIRES: Final = (
    "see that MISO, SCLK and chip select lead to the controller (all 00 or ff: MISO leads nowhere), and that "
    "spi.device and spi.speed_hz are right"
)


def _values(values: Measured) -> str:
    tilt = "no orientation" if values.tilt_deg is None else f"a tilt of {values.tilt_deg:.0f} degrees"
    return f"{values.voltage_v:.1f} V, {values.percent:.0f} %, {values.temperature_c:.0f} °C, {tilt}"
