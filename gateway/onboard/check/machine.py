"""The machine: Python, clock, memory, processor, supply, Wi-Fi and real-time rights."""

import array
import ctypes
import fcntl
import importlib.metadata
import os
import re
import resource
import socket
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Final

from gateway.host.realtime import LOOP_PRIORITY
from gateway.onboard.check import service_user
from gateway.onboard.check.table import INSTALL, SERVICE, CheckedRobot, Probe, Seen, text, warning

_UNSYNCHRONISED: Final = 5  # TIME_ERROR of adjtimex(2)
_TIMEX_BYTES: Final = 512  # larger than struct timex on any system; all zeros, it only asks
_LITTLE_MB: Final = 100
"""The service was seen to take 97 MB under a flood of messages."""
_ASK_POWER_SAVE, _DISABLED_BYTE = 0x8B2D, 21  # SIOCGIWPOWER; a struct iwreq begins with the name in 16 bytes


def _python(_: CheckedRobot) -> Seen:
    zenoh = importlib.metadata.version("eclipse-zenoh")
    return Seen(version=".".join(map(str, sys.version_info[:3])), zenoh=zenoh, python=sys.executable)


def _user(_: CheckedRobot) -> Seen | None:
    service = service_user.uid()
    return None if service is None else Seen(own=os.geteuid() == service, root=not os.geteuid())


def _clock(_: CheckedRobot) -> Seen | None:
    with suppress(AttributeError, OSError):  # not Linux: a laptop
        return Seen(adjtimex=int(ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))))
    return None


def _realtime(robot: CheckedRobot) -> Seen:
    """What the kernel has granted the service that runs; else whether this process may be scheduled before others."""
    seen = Seen(running=None, rejected="", limit=resource.getrlimit(resource.RLIMIT_RTPRIO)[0], to="this user")
    with suppress(OSError):
        threads = [int(each.name) for each in Path(f"/proc/{robot.unit.get('MainPID', 0)}/task").iterdir()]
        seen.running, seen.to = max(os.sched_getparam(each).sched_priority for each in threads), "the service that runs"
    if seen.running is None:
        with ThreadPoolExecutor(1) as thread:  # so that this one keeps its priority
            seen.rejected = thread.submit(_rejected_priority).result()
    seen.priority = seen.running or LOOP_PRIORITY
    return seen


def _rejected_priority() -> str:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(LOOP_PRIORITY))
    except OSError as error:
        return str(error.strerror)
    return ""


def _governor(robot: CheckedRobot) -> Seen | None:
    folder = robot.root / "sys/devices/system/cpu/cpu0/cpufreq"
    governor = text(folder / "scaling_governor")
    return Seen(governor=governor, driver=text(folder / "scaling_driver")) if governor else None


def _voltage(robot: CheckedRobot) -> Iterator[Seen]:
    for name in (robot.root / "sys/class/hwmon").glob("hwmon*/name"):
        if text(name) == "rpi_volt":
            yield Seen(low=text(name.with_name("in0_lcrit_alarm")) == "1")


def _memory(robot: CheckedRobot) -> Seen | None:
    found = re.search(r"^MemAvailable: +(\d+) kB", text(robot.root / "proc/meminfo"), re.MULTILINE)
    return Seen(free_mb=int(found[1]) // 1024) if found else None


def _wifi(robot: CheckedRobot) -> Iterator[Seen]:
    for folder in (robot.root / "sys/class/net").glob("*/phy80211"):
        asked = array.array("B", folder.parent.name.encode().ljust(32, b"\0"))
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
            fcntl.ioctl(any_socket, _ASK_POWER_SAVE, asked)
            yield Seen(wifi=folder.parent.name, saves=not asked[_DISABLED_BYTE])


_LATE: Final = "on a busy machine a Stop may be late"
_NM: Final = "/etc/NetworkManager/conf.d/hexapod-wifi.conf"
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
MACHINE: Final = (
    Probe("processor", _governor, (
        # Drivers that choose the clock in hardware give this name to a governor that does raise it.
        warning(lambda r: r.governor == "powersave" and not r.driver.endswith("pstate"),
                f"its governor is powersave, which keeps it at its lowest clock: {_LATE}",
                "echo 'w /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor - - - - performance' | "
                "sudo tee /etc/tmpfiles.d/hexapod-governor.conf && sudo systemd-tmpfiles --create "
                "hexapod-governor.conf"),
    )),
    Probe("supply", _voltage, (
        warning(lambda r: r.low, "this Raspberry Pi's supply is under its voltage: it may slow down, or restart",
                "use a supply of 5.1 V with enough current (a Pi 5: 5 A), and feed servos from another one"),
    )),
    Probe("memory", _memory, (
        warning(lambda r: r.free_mb < _LITTLE_MB,
                f"{{free_mb}} MB are free, and the service may need {_LITTLE_MB}: the kernel may end programs",
                "end what needs most of it: ps -eo rss,pid,comm --sort=-rss | head"),
    )),
    Probe("Wi-Fi", _wifi, (
        warning(lambda r: r.saves, "{wifi} saves power: commands arrive late and in bursts, which stops legs",
                f"printf '[connection]\\nwifi.powersave = 2\\n' | sudo tee {_NM} && "
                "sudo systemctl restart NetworkManager"),
    )),
    Probe("real-time", _realtime, (
        warning(lambda r: r.running == 0, f"the service that runs was granted none: {_LATE}",
                "see its journal; a kernel with CONFIG_RT_GROUP_SCHED may reject it"),
        warning(lambda r: r.rejected,
                f"priority {{priority}} is not granted ({{rejected}}; RLIMIT_RTPRIO is {{limit}}): {_LATE}",
                f"run it as the service, whose unit sets LimitRTPRIO ({INSTALL}); CONFIG_RT_GROUP_SCHED may reject it"),
    ), "priority {priority} is granted to {to}"),
)
# fmt: on
