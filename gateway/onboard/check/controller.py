"""The controller of elkapod-2025: its UART, and its heartbeat.

Nothing is written to it: the published firmware of HexapodProtocol v1.0.0 takes a frame's first byte for a length of
126, which leaves it deaf to Stops until its reset. Nor is anything read while a gateway runs: the heartbeats are its
own. The gateway itself judges the answers, which need frames.
"""

import errno
import os
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.errors import SpiError
from gateway.model.elkapod import Heartbeats
from gateway.onboard.check.device import JOIN_GROUP, NO_NODE, denied, node
from gateway.onboard.check.table import CheckedRobot, Probe, Seen, failure, warning
from gateway.robot.spi.uart import SerialUart

_ALLOWED: Final = "ttyAMA"
"""The unit's DeviceAllow=: the kernel's name of a Raspberry Pi's PL011 UARTs."""
_CYCLE_S: Final = 0.02
"""The robot's own driver has this cycle. Heartbeats come within 0.1 s, after which that driver starts again."""


def _uart(robot: CheckedRobot) -> Iterator[Seen]:
    """It is opened and closed, unless a gateway holds it."""
    path, root = robot.settings.controller.uart, robot.root
    if not robot.settings.spi.protocol.measures:
        return
    seen, name = node(path), Path(path).resolve().name
    seen.absent = "install again with --protocol elkapod-2025, which switches it on, and reboot; or set controller.uart"
    seen.tty, seen.kind, seen.opens = name, name.rstrip("0123456789"), f"opens, as {seen.user}"
    seen.console = seen.login = seen.held = seen.error = ""
    if not (seen.lack or seen.denied):
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


def _heartbeat(robot: CheckedRobot) -> Iterator[Seen]:
    """Listen only; nothing while a gateway runs, or where the UART's own line has the fault."""
    seen = next(_uart(robot), None)
    if seen is None or robot.gateway_runs or any((seen.lack, seen.denied, seen.console, seen.login, seen.error)):
        return
    with suppress(SpiError), closing(SerialUart(seen.path)) as line:
        yield heartbeat(line.read, round(robot.settings.controller.silent_ms * NS_PER_MS))


def heartbeat(
    read: Callable[[], bytes],
    silent_ns: int,
    clock: Callable[[], int] = time.monotonic_ns,
    pause: Callable[[float], None] = time.sleep,
) -> Seen:
    """What comes within `silent_ns`."""
    heartbeats, beats, received, until_ns = Heartbeats(), 0, 0, clock() + silent_ns
    while clock() < until_ns:
        pause(_CYCLE_S)
        data = read()
        received += len(data)
        beats += heartbeats.feed(data)
    return Seen(beats=beats, bytes=received, ms=silent_ns // NS_PER_MS)


_OFF: Final = (
    "sudo raspi-config nonint do_serial_cons 1 && sudo systemctl disable --now serial-getty@{tty}, see that "
    "/boot/firmware/cmdline.txt has no console={tty}, and reboot"
)
# fmt: off
CONTROLLER: Final = (
    Probe("UART", _uart, (
        NO_NODE,
        denied(lambda r: not r.group, "it is root's alone: sudo chgrp dialout {path} && sudo chmod 660 {path}"),
        denied(lambda r: not r.service, JOIN_GROUP),
        denied(lambda r: r.service,
               "install again with --protocol elkapod-2025, which lets the service's user be in dialout"),
        failure(lambda r: r.console, "{path} is the Linux console: the kernel's messages go to the controller", _OFF),
        failure(lambda r: r.login, "{path} is the terminal of {login}, which takes the controller's bytes", _OFF),
        failure(lambda r: r.held, "{path} is held by another program",
                "end that program: sudo fuser -v on the UART names it"),
        failure(lambda r: r.error, "{error}", "is {path} a UART? see dmesg"),
        warning(lambda r: r.service and not r.tty.startswith(_ALLOWED),
                f"{{path}} opens, but the unit lets the service open {_ALLOWED}… only",
                "sudo systemctl edit hexapod-gateway, with [Service] DeviceAllow=char-{kind} rw"),
    ), "{path} {opens}"),
    Probe("heartbeat", _heartbeat, (
        failure(lambda r: not r.beats, "none came in {ms} ms, but {bytes} other bytes",
                "see that the controller has power, that its TX leads to the Pi's RX, and both have the same ground; a "
                'controller of HexapodProtocol v1.0.0 needs spi.protocol = "hexapod-1.0"'),
    ), "{beats} came in {ms} ms, so the controller speaks elkapod-2025"),
)
# fmt: on
