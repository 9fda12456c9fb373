"""The machine: Python, clock, systemd unit, real-time rights."""

import ctypes
import importlib.metadata
import os
import resource
import shutil
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from gateway.people.tools.check.installation import RESTART
from gateway.people.tools.check.result import Result, failure, ok, warning
from gateway.robot.host.realtime import LOOP_PRIORITY

from gateway.people.tools.check import service_user

UNIT: Final = "hexapod-gateway"
_UNSYNCHRONISED: Final = 5  # TIME_ERROR of adjtimex(2)
_TIMEX_BYTES: Final = 512  # larger than struct timex on any system; all zeros, it only asks


def python() -> Result:
    """The interpreter and its Zenoh; pip has checked that their versions will do."""
    version = ".".join(map(str, sys.version_info[:3]))
    try:
        zenoh = importlib.metadata.version("eclipse-zenoh")
    except importlib.metadata.PackageNotFoundError:
        return failure("Python", f"{sys.executable} has no eclipse-zenoh", "pip install hexapod-gateway, into it")
    return ok("Python", f"{version} with eclipse-zenoh {zenoh}, {sys.executable}")


def clock() -> Result:
    """Whether the kernel reports that the clock is synchronised."""
    try:
        state = int(ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES)))
    except (AttributeError, OSError):  # not Linux
        state = -1
    return clock_result(state)


def clock_result(adjtimex: int) -> Result:
    """The result for what adjtimex(2) returned. The gateway does not depend on the clock, but certificates do."""
    fix = "switch time synchronisation on (timedatectl set-ntp true): certificates need a right clock"
    if adjtimex == _UNSYNCHRONISED:
        return warning("clock", "is not synchronised", fix)
    if adjtimex < 0:
        return warning("clock", "does not say whether it is synchronised", fix)
    return ok("clock", "is synchronised")


def unit(*, booted: Path = Path("/run/systemd/system"), systemctl: str = "systemctl") -> Result:
    """Whether systemd knows the service's unit, starts it at boot and runs it."""
    if not booted.is_dir() or shutil.which(systemctl) is None:
        return warning(
            "systemd unit",
            "none, for this machine does not run systemd",
            "let something start the gateway again when it ends, and run `hexapod-gateway stop-servos` then",
        )
    try:
        return unit_result(_shown("LoadState,ActiveState,UnitFileState,Result", systemctl))
    except (OSError, subprocess.SubprocessError) as error:
        return warning("systemd unit", f"systemctl does not tell ({error})", f"try: systemctl status {UNIT}")


def unit_result(properties: Mapping[str, str]) -> Result:
    """The result for what `systemctl show` printed."""
    name = "systemd unit"
    load, active = properties.get("LoadState", ""), properties.get("ActiveState", "")
    enabled = properties.get("UnitFileState", "")
    if load == "not-found":
        return warning(name, "is not installed: nothing stops the servos if the gateway dies", "sudo deploy/install.sh")
    if load != "loaded":
        return failure(name, f"cannot be loaded ({load})", f"systemctl status {UNIT} says why")
    if active == "failed":
        return failure(
            name,
            f"has failed ({properties.get('Result', '?')})",
            f"journalctl -u {UNIT} says why; then: {RESTART}",
        )
    if not enabled.startswith("enabled"):
        return warning(name, f"is {active}, but does not start with the machine", f"sudo systemctl enable --now {UNIT}")
    if active != "active":
        return warning(name, f"is enabled, but {active}", f"sudo systemctl start {UNIT}")
    return ok(name, "is enabled and active")


def is_no_unit(result: Result) -> bool:
    """Whether `unit` found that systemd has none that could be started."""
    return result.sentence.startswith(("is not installed", "cannot be loaded (masked)"))


def granted_rtprio() -> int | None:
    """The real-time priority that the unit allows the service; None where there is no unit."""
    said = _show("LoadState,LimitRTPRIO")
    return int(said["LimitRTPRIO"]) if said.get("LoadState") == "loaded" and said["LimitRTPRIO"].isdigit() else None


def running_realtime() -> Result | None:
    """What the kernel has granted the service that runs; None where none does."""
    try:
        threads = [int(thread.name) for thread in Path(f"/proc/{main_process()}/task").iterdir()]
        first = [os.sched_getparam(thread).sched_priority for thread in threads]
    except OSError:
        return None
    if any(first):
        return ok("real-time", f"priority {max(first)} is granted to the service that runs")
    return warning(
        "real-time",
        "the service that runs was granted none: on a busy machine a Stop may be late",
        "its journal says why; a kernel with CONFIG_RT_GROUP_SCHED may reject it",
    )


def main_process() -> int:
    """The number of the service's process; 0: none runs here."""
    return int(_show("MainPID").get("MainPID", "0"))


def _show(properties: str) -> dict[str, str]:
    try:
        return _shown(properties)
    except (OSError, subprocess.SubprocessError):
        return {}


def _shown(properties: str, systemctl: str = "systemctl") -> dict[str, str]:
    command = [systemctl, "show", UNIT, f"--property={properties}"]
    said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=5).stdout
    return dict(line.split("=", 1) for line in said.splitlines() if "=" in line)


def realtime() -> Result:
    """Whether this process may be scheduled before others: on a busy machine that keeps a Stop from being late."""
    name, priority = "real-time", LOOP_PRIORITY
    if not hasattr(os, "sched_setscheduler"):
        return warning(name, "this system has no SCHED_FIFO", "run the gateway on Linux")
    faults: list[OSError] = []

    def ask() -> None:  # on a thread of its own, so that this one keeps its priority
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        except OSError as error:
            faults.append(error)

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    if not faults:
        return ok(name, f"priority {priority} is granted")
    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    granted = granted_rtprio() if os.geteuid() == service_user.uid() else None
    if granted is not None and 0 <= limit < granted:  # as root it would have been raised to what the unit grants
        return warning(
            name,
            f"the unit grants priority {granted}, but it cannot be tried here: this container lacks CAP_SYS_RESOURCE",
            "start the service and check again: then what the kernel has granted it is looked at",
        )
    if 0 <= limit < priority:
        return warning(
            name,
            f"priority {priority} is not granted (RLIMIT_RTPRIO is {limit}): on a busy machine a Stop may be late",
            "run it as the service, whose unit sets LimitRTPRIO (sudo deploy/install.sh)",
        )
    return warning(
        name,
        f"priority {priority} is rejected by this kernel ({faults[0].strerror}): on a busy machine a Stop may be late",
        "use a kernel without CONFIG_RT_GROUP_SCHED, or keep other work off this machine",
    )
