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
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.errors import SpiError
from gateway.model import elkapod
from gateway.model.elkapod import SHUTDOWN, Heartbeats, Measured
from gateway.model.frames import STOP_REPEAT_MS, STOP_REPEATS
from gateway.onboard.check.device import JOIN_GROUP, denied, no_node, node
from gateway.onboard.check.table import CheckedRobot, Probe, Result, Seen, Verdict, failure, results, warning
from gateway.robot.protocol.elkapod import FROZEN_NS, SignsOfLife
from gateway.robot.spi import DuplexDevice
from gateway.robot.spi.kernel import KernelDevice
from gateway.robot.spi.machine import computer
from gateway.robot.spi.uart import SerialUart, Uart
from schemas.robot import SERVO_IDS

_ALLOWED: Final = "ttyAMA"
"""The unit's DeviceAllow=: the kernel's name of a Raspberry Pi's PL011 UARTs."""
_CYCLE_S: Final = 0.02
"""The robot's own driver has this cycle. Heartbeats come within 0.1 s, after which that driver starts again."""
_MIDDLE: Final = elkapod.frame([elkapod.MIDDLE_CDEG] * len(SERVO_IDS))
_NOISY: Final = frozenset({"angular velocity", "linear acceleration"})
"""Without noise there is no gyroscope and no accelerometer."""


def look(robot: CheckedRobot) -> Iterator[Result]:
    """Whether the UART can be used, and a controller of this protocol is at its other end, where no gateway runs."""
    found = list(results([UART], robot))
    yield from found
    if robot.gateway_runs or any(each.verdict is Verdict.FAILURE for each in found):
        return
    spi, silent_ms = robot.settings.spi, robot.settings.controller.silent_ms
    try:
        line = SerialUart(robot.settings.controller.uart)
    except SpiError as error:  # taken since
        yield Result(UART.name, Verdict.FAILURE, str(error), _END_IT)
        return
    try:
        yield from results(TALK, Talk(
            line,
            lambda: KernelDevice(spi.device, spi.speed_hz, mode=spi.protocol.spi_mode),
            silent_ns=round(silent_ms * NS_PER_MS),
            shutdowns=[STOP_REPEAT_MS / 1e3] * (1 + STOP_REPEATS),
        ))  # fmt: skip
    finally:
        line.close()


# ---- the UART


def _uart(robot: CheckedRobot) -> Iterator[Seen]:
    """It is opened and closed, unless a gateway holds it."""
    path, root = robot.settings.controller.uart, robot.root
    seen, name = node(path), Path(path).resolve().name
    number = re.fullmatch(r"ttyAMA([0-4])", Path(path).name)
    seen.absent = "switch this UART on as this computer wants it, and reboot; or set controller.uart"
    if number and re.match(r"Raspberry Pi (5|Compute Module 5)", computer(root)):
        overlay = f"dtoverlay=uart{number[1]}-pi5 in /boot/firmware/config.txt"
        seen.absent = f"switch it on ({overlay}) and reboot; or set controller.uart"
    seen.tty, seen.kind, seen.console, seen.login, seen.held, seen.error = (
        name,
        name.rstrip("0123456789"),
        "",
        "",
        "",
        "",
    )
    seen.opens = f"opens, as {seen.user}"
    if not seen.lack:
        seen.console = name in _text(root / "sys/class/tty/console/active").split()
        seen.login = next(_logins(os.stat(path).st_rdev, root), "")
        if robot.gateway_runs:
            seen.opens, seen.service = "is the running gateway's, which reports whether the controller answers", False
        elif not (seen.console or seen.login):
            try:
                SerialUart(path).close()
            except SpiError as error:
                cause = error.__cause__
                seen.held = isinstance(cause, OSError) and cause.errno in (errno.EAGAIN, errno.EBUSY)
                seen.error = str(error)
    yield seen


def _logins(rdev: int, root: Path) -> Iterator[str]:
    """The programs whose controlling terminal it is: /proc shows that of everybody's."""
    major, minor = os.major(rdev), os.minor(rdev)
    terminal = str(minor & 0xFF | major << 8 | (minor & ~0xFF) << 12)
    for file in (root / "proc").glob("[0-9]*/stat"):
        head, _, rest = _text(file).rpartition(") ")
        if rest.split()[4:5] == [terminal]:  # state, parent, group, session, terminal
            yield head.partition(" (")[2]


def _text(file: Path) -> str:
    with suppress(OSError):  # of a process that has ended
        return file.read_text(errors="replace")
    return ""


# ---- the controller


@dataclass
class Talk:
    """Both wires to a controller. `silent_ns`: how long each may be silent. `shutdowns`: pauses behind each, in s."""

    line: Uart
    open_device: Callable[[], DuplexDevice]
    silent_ns: int
    shutdowns: Sequence[float]
    clock: Callable[[], int] = time.monotonic_ns
    pause: Callable[[float], None] = time.sleep
    beats: int = 0


def _heartbeats(talk: Talk) -> Iterator[Seen]:
    """Listen only."""
    heartbeats, received, error, until_ns = Heartbeats(), 0, "", talk.clock() + talk.silent_ns
    try:
        while talk.clock() < until_ns:
            talk.pause(_CYCLE_S)
            data = talk.line.read()
            received += len(data)
            talk.beats += heartbeats.feed(data)
    except SpiError as failed:
        error, talk.beats = str(failed), 0
    yield Seen(beats=talk.beats, bytes=received, error=error, ms=talk.silent_ns // NS_PER_MS)


def _answers(talk: Talk) -> Iterator[Seen]:
    """After a heartbeat: shut down and clock frames, and judge the answers as the gateway does."""
    if not talk.beats:
        return
    try:
        device = talk.open_device()
        try:
            yield _asked(talk, device)
        finally:
            device.close()
    except SpiError as error:
        yield Seen(error=str(error))


def _asked(talk: Talk, device: DuplexDevice) -> Seen:
    for pause_s in talk.shutdowns:
        talk.line.write(SHUTDOWN)
        talk.pause(pause_s)
    signs, measured, well, badly = SignsOfLife(talk.silent_ns, talk.clock()), None, 0, 0
    # Long enough that one which freezes falls silent, and that a sensor which measures changes its values.
    until_ns = talk.clock() + talk.silent_ns + FROZEN_NS + round(5e9 * _CYCLE_S)
    while talk.clock() < until_ns:
        measured = signs.answered(device.exchange(_MIDDLE), talk.clock())
        well, badly = (well, badly + 1) if measured is None else (well + 1, badly)
        talk.pause(_CYCLE_S)
        signs.heard(talk.line.read(), talk.clock())
    dead = measured is None or not signs.alive(talk.clock())
    constant = signs.changes.constant
    return Seen(
        error="", badly=badly, count=f"{well} of {well + badly} are well formed, with all servos shut down",
        dead=dead and (signs.silent(talk.clock()) or "the last one is not well formed"),
        values="" if measured is None else _values(measured), noisy=set(constant) >= _NOISY,
        constant=f"; constant all the time: {', '.join(constant)}" if constant else "",
    )  # fmt: skip


def _values(values: Measured) -> str:
    tilt = "no orientation" if values.tilt_deg is None else f"a tilt of {values.tilt_deg:.0f} degrees"
    return f"{values.voltage_v:.1f} V, {values.percent:.0f} %, {values.temperature_c:.0f} °C, {tilt}"


_END_IT: Final = "end that program: sudo fuser -v on the UART names it"
_OFF: Final = (
    "sudo raspi-config nonint do_serial_cons 1 && sudo systemctl disable --now serial-getty@{tty}, see that "
    "/boot/firmware/cmdline.txt has no console={tty}, and reboot"
)
_NO_POWER: Final = (
    "see that the controller has power, that its TX leads to the Pi's RX, and both have the same ground; a controller "
    'of HexapodProtocol v1.0.0 needs spi.protocol = "hexapod-1.0"'
)
_WIRES: Final = (
    "see that MISO, SCLK and chip select lead to the controller (all 00 or ff: MISO leads nowhere), and that "
    "spi.device and spi.speed_hz are right"
)
# fmt: off
UART: Final = Probe("UART", _uart, (
    *no_node("controller.uart"),
    denied(lambda r: not r.group, "{path} belongs to root alone: sudo chgrp dialout {path} && sudo chmod 660 {path}"),
    denied(lambda r: not r.service, JOIN_GROUP),
    denied(lambda r: r.service,
           "install again with --protocol elkapod-2025, which lets the service's user be in dialout"),
    failure(lambda r: r.console, "{path} is the Linux console: the kernel's messages go to the controller", _OFF),
    failure(lambda r: r.login, "{path} is the terminal of {login}, which takes the controller's bytes", _OFF),
    failure(lambda r: r.held, "{path} is held by another program", _END_IT),
    failure(lambda r: r.error, "{error}", "is {path} a UART? see dmesg"),
    warning(lambda r: r.service and not r.tty.startswith(_ALLOWED),
            f"{{path}} opens, but the unit lets the service open {_ALLOWED}… only",
            "sudo systemctl edit hexapod-gateway, with [Service] DeviceAllow=char-{kind} rw"),
), "{path} {opens}")
_SILENT: Final = "so nothing was written to the controller"
TALK: Final = (
    Probe("heartbeat", _heartbeats, (
        failure(lambda r: r.error, "{error}", "see dmesg"),
        failure(lambda r: not r.beats and r.bytes,
                f"{{bytes}} bytes came in {{ms}} ms, and no heartbeat among them; {_SILENT}", _NO_POWER),
        failure(lambda r: not r.beats, f"none came in {{ms}} ms; {_SILENT}", _NO_POWER),
    ), "{beats} came in {ms} ms, so the controller speaks elkapod-2025"),
    Probe("answers", _answers, (
        failure(lambda r: r.error, "{error}", "see dmesg"),
        failure(lambda r: r.dead, "{dead}; {count}", _WIRES),
        warning(lambda r: r.badly > 1, "{count}", _WIRES),  # the first one after power-up may be anything
        warning(lambda r: r.noisy, "{count}: {values}{constant}",
                "see that the inertial sensor is connected, and that its part of the firmware runs; the robot walks "
                "without it, but safety.max_tilt_deg then sees no fall"),
    ), "{count}: {values}{constant}"),
)
# fmt: on
