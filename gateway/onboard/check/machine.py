"""The machine: Python, clock, memory, processor, systemd unit, real-time rights, and which release runs."""

import ctypes
import importlib.metadata
import os
import re
import resource
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from gateway.host.realtime import LOOP_PRIORITY
from gateway.onboard.check import service_user
from gateway.onboard.check.table import INSTALL, RESTART, SERVICE, CheckedRobot, Probe, Seen, failure, warning
from gateway.onboard.whole import INSTALLED

_UNSYNCHRONISED: Final = 5  # TIME_ERROR of adjtimex(2)
_TIMEX_BYTES: Final = 512  # larger than struct timex on any system; all zeros, it only asks
_LITTLE_MB: Final = 100
"""The service was seen to take 97 MB under a flood of messages."""


def show(unit: str, properties: str) -> dict[str, str]:
    """What `systemctl show` prints of a unit. Raises OSError, SubprocessError."""
    command = ["systemctl", "show", *([unit] if unit else []), f"--property={properties}"]
    shown = subprocess.run(command, capture_output=True, text=True, check=True, timeout=5).stdout
    return dict(line.split("=", 1) for line in shown.splitlines() if "=" in line)


def _shown(properties: str) -> dict[str, str]:
    with suppress(OSError, subprocess.SubprocessError):
        return show(SERVICE, properties)
    return {}


def granted_rtprio() -> int | None:
    """The real-time priority that the unit allows the service; None where there is no unit."""
    found = _shown("LoadState,LimitRTPRIO")
    return int(found["LimitRTPRIO"]) if found.get("LoadState") == "loaded" and found["LimitRTPRIO"].isdigit() else None


def main_process() -> int:
    """The number of the service's process; 0: none runs here."""
    return int(_shown("MainPID").get("MainPID", "0"))


def _python(_: CheckedRobot) -> Iterator[Seen]:
    zenoh = importlib.metadata.version("eclipse-zenoh")
    yield Seen(version=".".join(map(str, sys.version_info[:3])), zenoh=zenoh, python=sys.executable)


def _user(_: CheckedRobot) -> Iterator[Seen]:
    service = service_user.uid()
    if service is not None:
        yield Seen(own=os.geteuid() == service, root=not os.geteuid())


def _clock(_: CheckedRobot) -> Iterator[Seen]:
    with suppress(AttributeError, OSError):  # not Linux: a laptop
        yield Seen(adjtimex=int(ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))))


def _unit(robot: CheckedRobot) -> Iterator[Seen]:
    found, error = dict[str, str](), ""
    systemd = (robot.root / "run/systemd/system").is_dir() and shutil.which("systemctl")
    try:
        found = show(SERVICE, "LoadState,ActiveState,UnitFileState,Result") if systemd else {}
    except (OSError, subprocess.SubprocessError) as failed:
        error = str(failed)
    seen = Seen(systemd=systemd, error=error, load=found.get("LoadState", ""), active=found.get("ActiveState", ""))
    seen.enabled, seen.result = found.get("UnitFileState", ""), found.get("Result", "?")
    if not (robot.installed and seen.load in ("not-found", "masked")):  # the installation's line has the fix
        yield seen


def _realtime(_: CheckedRobot) -> Iterator[Seen]:
    """What the kernel has granted the service that runs; else whether this process may be scheduled before others."""
    seen = Seen(running=None, rejected="", limit=resource.getrlimit(resource.RLIMIT_RTPRIO)[0], to="this user")
    with suppress(OSError):
        threads = [int(thread.name) for thread in Path(f"/proc/{main_process()}/task").iterdir()]
        seen.running, seen.to = max(os.sched_getparam(each).sched_priority for each in threads), "the service that runs"
    if seen.running is None:
        thread = threading.Thread(target=_ask_for_priority, args=(seen,))  # so that this one keeps its priority
        thread.start()
        thread.join()
    seen.priority = seen.running or LOOP_PRIORITY
    yield seen


def _ask_for_priority(seen: Seen) -> None:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(LOOP_PRIORITY))
    except OSError as error:
        seen.rejected = error.strerror


def running_release(process: int, root: Path = Path("/")) -> Path | None:
    """The folder that a process has loaded the gateway from; None where none runs, or this user may not look.

    The kernel reports it: the command line names the link, which may lead elsewhere by now.
    """
    with suppress(OSError):
        found = re.search(rf"{INSTALLED}-[^/ \n]+", (root / f"proc/{process}/maps").read_text())
        return Path(found.group()) if found else None
    return None


def _release(runs: Path | None) -> Iterator[Seen]:
    if runs is not None and INSTALLED.exists():
        yield Seen(runs=runs, installed=INSTALLED.resolve())


def _governors(robot: CheckedRobot) -> Iterator[Seen]:
    folders = _found(robot.root / "sys/devices/system/cpu", "cpu[0-9]*/cpufreq")
    if folders:
        yield Seen(governor=_text(folders[0] / "scaling_governor"), driver=_text(folders[0] / "scaling_driver"))


def _voltage(robot: CheckedRobot) -> Iterator[Seen]:
    for name in _found(robot.root / "sys/class/hwmon", "hwmon*/name"):
        if _text(name) == "rpi_volt":
            yield Seen(low=_text(name.with_name("in0_lcrit_alarm")) == "1")


def _found(folder: Path, pattern: str) -> list[Path]:
    """Nothing where this user may not look, as in the tests' emulated /sys."""
    with suppress(PermissionError):
        return sorted(folder.glob(pattern))
    return []


def _memory(robot: CheckedRobot) -> Iterator[Seen]:
    found = re.search(r"^MemAvailable: +(\d+) kB", _text(robot.root / "proc/meminfo"), re.MULTILINE)
    if found:
        yield Seen(free_mb=int(found[1]) // 1024)


def _text(path: Path) -> str:
    with suppress(OSError):
        return path.read_text().strip()
    return ""


# fmt: off
PYTHON: Final = Probe("Python", _python, (), "{version} with eclipse-zenoh {zenoh}, {python}")
USER: Final = Probe("user", _user, (
    warning(lambda r: r.root and not r.own, f"all this is what root may do; the service is {SERVICE}",
            f"outside of this container, or with its rights SETUID and SETGID: root may not become {SERVICE} here"),
    warning(lambda r: not r.own, f"all this is what you may do; the service is {SERVICE}",
            "sudo hexapod-gateway check"),
), f"all this is what {SERVICE} may do, the service's user")
CLOCK: Final = Probe("clock", _clock, (
    warning(lambda r: r.adjtimex == _UNSYNCHRONISED, "is not synchronised",
            "switch time synchronisation on (timedatectl set-ntp true): certificates need a right clock"),
), "is synchronised")
UNIT: Final = Probe("systemd unit", _unit, (
    warning(lambda r: not r.systemd, "none, for this machine does not run systemd",
            "let something start the gateway again when it ends, and run `hexapod-gateway stop-servos` then"),
    warning(lambda r: r.error, "systemctl fails ({error})", f"try: systemctl status {SERVICE}"),
    warning(lambda r: r.load == "not-found", "is not installed: nothing stops the servos if the gateway dies", INSTALL),
    failure(lambda r: r.load != "loaded", "cannot be loaded ({load})", f"systemctl status {SERVICE} shows why"),
    failure(lambda r: r.active == "failed", "has failed ({result})",
            f"journalctl -u {SERVICE} shows why; then: {RESTART}"),
    warning(lambda r: not r.enabled.startswith("enabled"), "is {active}, but does not start with the machine",
            f"sudo systemctl enable --now {SERVICE}"),
    warning(lambda r: r.active != "active", "is enabled, but {active}", f"sudo systemctl start {SERVICE}"),
), "is enabled and active")
_LATE: Final = "on a busy machine a Stop may be late"
REALTIME: Final = Probe("real-time", _realtime, (
    warning(lambda r: r.running == 0, f"the service that runs was granted none: {_LATE}",
            "see its journal; a kernel with CONFIG_RT_GROUP_SCHED may reject it"),
    warning(lambda r: r.rejected,
            f"priority {{priority}} is not granted ({{rejected}}; RLIMIT_RTPRIO is {{limit}}): {_LATE}",
            f"run it as the service, whose unit sets LimitRTPRIO ({INSTALL}); CONFIG_RT_GROUP_SCHED may reject it"),
), "priority {priority} is granted to {to}")
GOVERNOR: Final = Probe("processor", _governors, (
    # Drivers that choose the clock in hardware give this name to a governor that does raise it.
    warning(lambda r: r.governor == "powersave" and not r.driver.endswith("pstate"),
            f"its governor is powersave, which keeps it at its lowest clock: {_LATE}",
            "echo 'w /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor - - - - performance' | "
            "sudo tee /etc/tmpfiles.d/hexapod-governor.conf && sudo systemd-tmpfiles --create hexapod-governor.conf"),
))
VOLTAGE: Final = Probe("supply", _voltage, (
    warning(lambda r: r.low, "this Raspberry Pi's supply is under its voltage: it may slow down, or restart",
            "use a supply of 5.1 V with enough current (a Pi 5: 5 A), and feed servos from another one"),
))
MEMORY: Final = Probe("memory", _memory, (
    warning(lambda r: r.free_mb < _LITTLE_MB,
            f"{{free_mb}} MB are free, and the service may need {_LITTLE_MB}: the kernel may end programs",
            "end what needs most of it: ps -eo rss,pid,comm --sort=-rss | head"),
))
RELEASE: Final = Probe("release", _release, (
    warning(lambda r: r.runs != r.installed,
            "the service that runs is another release than the one installed: {runs}, not {installed}",
            f"stop the robot, then: sudo systemctl restart {SERVICE}"),
))
# fmt: on
