"""Probes of the machine and the service: release, unit, drop-ins, user, state directory. They read as root.

`tests/box/test_check_faults.py` plants each fault and runs the remedy, from its first `sudo` to the line's end.
"""

import array
import ctypes
import fcntl
import grp
import importlib.metadata
import os
import platform
import re
import resource
import shlex
import shutil
import socket
import stat
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Final

from gateway import certs
from gateway.errors import ConfigError
from gateway.host.kernel_tables import FORGETS, mount_of
from gateway.host.realtime import LOOP_PRIORITY
from gateway.onboard import whole
from gateway.onboard.check.table import INSTALL, RESTART, SERVICE, CheckedRobot, Probe, Seen, failure, text, warning

ETC: Final = f"/etc/{SERVICE}"
TEMPLATE: Final = f"/usr/share/{SERVICE}/gateway.toml"
STATE_FOLDER: Final = f"/var/lib/{SERVICE}"
_NEEDED: Final = ("spi", "dialout", SERVICE)
"""Groups of the unit."""
_FORMER: Final = (f"/usr/local/bin/{SERVICE}", f"/opt/{SERVICE}")
_SHEBANG: Final = 127
"""Bytes of a first line that Linux reads."""
_MOST_FILES: Final = 20_000
"""Most files read of the state directory."""
_LEAST_FREE_MB: Final = 20
"""Room for some calibrations and lists."""
_LEAST_INODES: Final = 100
_LITTLE_MB: Final = 100
"""The service needs 60 to 70 (docs/design.md, *How fast*), and an upgrade tries the next release at the same time."""
_HARMLESS: Final = frozenset(
    ("Description", "After", "Wants", "Environment", "ReadWritePaths", "CPUWeight", "IOWeight", "LogLevelMax")
)
"""Keys that a drop-in may set. A Stop may depend on any other."""
_OURS: Final = re.compile(r"\b(?:HEXAPOD_|PYTHON|GATEWAY_)\w+")
"""Variables that change what the service does."""
_ASSIGNED: Final = re.compile(r"^[ \t]*(\w+)[ \t]*=[ \t]*(.*?)[ \t]*$", re.MULTILINE)
_UNSYNCHRONISED, _TIMEX_BYTES = 5, 512  # TIME_ERROR of adjtimex(2); more than its struct has, all zeros: it only asks
_ASK_POWER_SAVE, _DISABLED_BYTE = 0x8B2D, 21  # SIOCGIWPOWER; a struct iwreq begins with the name in 16 bytes


# ---- the machine


def _clock(_: CheckedRobot) -> Seen | None:
    with suppress(AttributeError, OSError):  # not Linux: a laptop
        return Seen(adjtimex=int(ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))))
    return None


def _realtime(robot: CheckedRobot) -> Seen:
    """Read the priority that the kernel granted the running service; without one, whether this process gets it."""
    seen = Seen(running=None, rejected="", limit=resource.getrlimit(resource.RLIMIT_RTPRIO)[0], to="this user")
    with suppress(OSError):
        threads = [int(each.name) for each in Path(f"/proc/{robot.unit.get('MainPID', 0)}/task").iterdir()]
        seen.running, seen.to = max(os.sched_getparam(each).sched_priority for each in threads), "the service that runs"
    if seen.running is None:
        priority = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(LOOP_PRIORITY)
        with ThreadPoolExecutor(1) as thread:  # so that this one keeps its priority
            fault = thread.submit(os.sched_setscheduler, 0, *priority).exception()
        seen.rejected = fault.strerror if isinstance(fault, OSError) else ""
    seen.priority = seen.running or LOOP_PRIORITY
    return seen


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


# ---- release and unit


def names(found: Sequence[str], folder: Path | str, **more: object) -> Seen | None:
    """Return a reading with these paths, the first few for a sentence, all for a command; None if there are none."""
    rest = f" and {len(found) - whole.SHOWN} more" if len(found) > whole.SHOWN else ""
    paths = shlex.join(str(Path(folder, each)) for each in found)
    return Seen(some=", ".join(found[: whole.SHOWN]) + rest, all=paths, **more) if found else None


def _release(robot: CheckedRobot) -> Seen | None:
    """Read the installed release, the one that `current` links to, and the one that the service has loaded."""
    link = robot.path(whole.CURRENT)
    loaded = re.search(rf"{whole.LIBRARY}/([^/\s]+)/", text(robot.path(f"proc/{robot.unit.get('MainPID', 0)}/maps")))
    if not link.is_dir():
        return None
    current = link.resolve().name.removesuffix(".kept")
    runs = loaded[1].removesuffix(".kept") if loaded else current
    former = [each for each in _FORMER if robot.path(each).exists()]
    return Seen(current=current, package=robot.package or current, runs=runs, former=former)


def _unit_file(robot: CheckedRobot) -> Seen | None:
    """Read the unit in force, compared with that of the release."""
    unit, place, link = robot.unit, f"/usr/lib/systemd/system/{SERVICE}.service", robot.path(whole.CURRENT)
    wanted, found = text(link / f"units/{SERVICE}.service"), unit.get("FragmentPath", "")
    return Seen(
        masked=unit.get("LoadState") == "masked" or (found and not text(robot.path(found))), found=found, place=place,
        other=found and robot.path(found).resolve() != robot.path(place).resolve(),
        differs=wanted != text(robot.path(place)), source=f"{whole.CURRENT}/units/{SERVICE}.service",
    ) if wanted else None  # fmt: skip


def _unit(robot: CheckedRobot) -> Seen | None:
    """`program`: a program of the unit, or its interpreter, that cannot be executed."""
    unit, needs = robot.unit, list[str]()
    for path in re.findall(r"path=(\S+)", f"{unit.get('ExecStart')} {unit.get('ExecStopPost')}"):
        needs += [path, *re.findall(r"^#! *(\S+)", text(robot.path(path))[:_SHEBANG])]
    return None if unit.get("LoadState") == "masked" else Seen(
        systemd=(robot.root / "run/systemd/system").is_dir() and shutil.which("systemctl"),
        program=next((each for each in needs if not os.access(robot.path(each), os.X_OK)), ""),
        load=unit.get("LoadState", ""), active=unit.get("ActiveState", ""), enabled=unit.get("UnitFileState", ""),
        result=unit.get("Result", ""), stops="stop-servos" in unit.get("ExecStopPost", ""),
    )  # fmt: skip


def _reload(robot: CheckedRobot) -> Seen:
    """Units and drop-ins that systemd has not reloaded. It does not notice a drop-in in a new folder."""
    folders = (robot.path(f"{root}/systemd/system/{SERVICE}.service.d") for root in ("etc", "run"))
    found = {f"/{path.relative_to(robot.root)}" for folder in folders for path in folder.glob("*.conf")}
    unread = found - set(robot.unit.get("DropInPaths", "").split())
    return Seen(unread=robot.unit and (unread or robot.unit.get("NeedDaemonReload") == "yes"))


def _drop_ins(robot: CheckedRobot) -> Iterator[Seen]:
    """Read as systemd does: a backslash at the end continues a line, # and ; begin comments."""
    for path in robot.unit.get("DropInPaths", "").split():
        assigned = _ASSIGNED.findall(text(robot.path(path)).replace("\\\n", " "))
        environment = " ".join(value for key, value in assigned if key == "Environment")
        after, keys = [value for key, value in assigned if key == "ExecStopPost"], {key for key, _ in assigned}
        yield Seen(
            path=path, environment=environment, keys=", ".join(sorted(keys)), simulates="--sim" in environment,
            emptied="" in after and not any("stop-servos" in each for each in after[after.index("") :]),
            depends=", ".join(sorted(keys - _HARMLESS | set(re.findall(r"\bPYTHON\w+", environment)))),
        )  # fmt: skip


def _variables(robot: CheckedRobot) -> Iterator[Seen]:
    """Variables of the service, or of its process, that neither unit nor drop-in sets."""
    process = text(robot.path(f"proc/{robot.unit.get('MainPID', 0)}/environ")).replace("\0", " ")
    theirs = set(_OURS.findall(f"{robot.environment} {process}"))
    for name in sorted(theirs - set(_OURS.findall(robot.unit.get("Environment", "")))):
        yield Seen(name=name)


def _new_settings(robot: CheckedRobot) -> Seen | None:
    """Settings of this release that gateway.toml does not mention, also not in a comment."""
    mentioned, known = _mentioned(text(robot.path(f"{ETC}/gateway.toml"))), _mentioned(text(robot.path(TEMPLATE)))
    new = sorted(known - mentioned) if mentioned else []
    return Seen(new=", ".join(new)) if new else None


def _mentioned(toml: str) -> set[str]:
    section, found = "", set[str]()
    for line in toml.splitlines():
        if head := re.match(r"(?:# )?\[([\w.]+)\]", line):
            section = f"{head[1]}."
        elif name := re.match(r"(?:# ?)?([a-z_.]+) *= ", line):
            found.add(name[1] if "." in name[1] else section + name[1])
    return found


# ---- user, files and disks


def _users(robot: CheckedRobot) -> Iterator[Seen]:
    """Yield a missing user, or each missing group."""
    there = {each.gr_name for each in grp.getgrall()}
    found = [f"user {SERVICE}"] if robot.service is None else [f"group {each}" for each in _NEEDED if each not in there]
    return (Seen(missing=each) for each in found)


def _state(robot: CheckedRobot) -> Iterator[Seen | None]:
    """Read the state directory, and files in it that the service does not own or may not read and write.

    Nothing if it does not exist: the service's first start makes it.
    """
    folder, found = robot.path(STATE_FOLDER), list[str]()
    if robot.service is None or not folder.exists():
        return
    is_folder, own = folder.is_dir(), folder.stat().st_uid == robot.service[0]
    yield Seen(is_folder=is_folder, kind=mount_of(folder)[1], own=_is_own(folder.resolve(), robot), some="")
    for path, _ in zip(folder.rglob("*") if own and is_folder else (), range(_MOST_FILES), strict=False):
        with suppress(OSError):
            found += [] if _is_own(path, robot) else [str(path.relative_to(folder))]
    yield names(found, folder, is_folder=True, own=True, kind="")


def _is_own(path: Path, robot: CheckedRobot) -> bool:
    status = path.lstat()
    needed = stat.S_IRWXU if stat.S_ISDIR(status.st_mode) else stat.S_IRUSR | stat.S_IWUSR
    return status.st_uid == (robot.service or (-1,))[0] and status.st_mode & needed == needed


def _disks(robot: CheckedRobot) -> Iterator[Seen]:
    """Read the file systems of the state directory and of the root."""
    for mount in dict.fromkeys(mount_of(each)[0] for each in (robot.path(STATE_FOLDER), robot.root)):
        disk = os.statvfs(mount)
        free_mb, inodes = disk.f_bavail * disk.f_frsize >> 20, disk.f_favail if disk.f_files else _LEAST_INODES
        yield Seen(mount=mount, read_only=disk.f_flag & os.ST_RDONLY, free_mb=free_mb, inodes=inodes)


def _keys(robot: CheckedRobot) -> Iterator[Seen | None]:
    """Private keys that others may read by the file's own mode, and keys of an authority, found by name or by the
    certificate next to them."""
    folder = robot.path(ETC)
    found = sorted(path for path in folder.rglob("*.key") if path.is_file())
    of_authority = (each for each in found if each.stem == "ca" or each.stem.endswith("-ca") or _is_of_authority(each))
    yield names([str(each) for each in found if _exposed(each.stat(), robot)], folder, exposed=True)
    yield names(list(map(str, of_authority)), folder, exposed=False)


def _exposed(status: os.stat_result, robot: CheckedRobot) -> bool:
    user, group = robot.service or (status.st_uid, status.st_gid)
    others = status.st_mode & 0o007 or (status.st_mode & 0o060 and status.st_gid not in (0, group))
    return bool(others) or status.st_uid not in (0, user)


def _is_of_authority(key: Path) -> bool:
    with suppress(ConfigError):
        public = certs.files.read_key(key).public_key()
        return any(public == each.public_key() for each in certs.files.read_certificates(key.with_name("ca.pem")))
    return False


# ---- the table

_ASIDE: Final = f"sudo mv {{path}} {{path}}.off && sudo systemctl daemon-reload && {RESTART}"
_OWN_STATE: Final = (
    f"sudo chown -R {SERVICE}:{SERVICE} {STATE_FOLDER} && sudo chmod -R u+rwX {STATE_FOLDER} && {RESTART}"
)
_AFTER: Final = f"sudo systemctl daemon-reload && sudo systemctl enable {SERVICE} && {RESTART}"
_CANNOT_START: Final = "the service cannot start, nor stop the servos after its end"
_NOT_KEPT: Final = "no calibration, emergency stop or list is kept"
_LATE: Final = "on a busy machine a Stop may be late"
_NM: Final = "/etc/NetworkManager/conf.d/hexapod-wifi.conf"
# fmt: off
_ZENOH: Final = importlib.metadata.version("eclipse-zenoh")
PYTHON: Final = Probe("Python", lambda _: Seen(), (), f"{platform.python_version()} with eclipse-zenoh {_ZENOH}, "
                      f"{sys.executable}")
USER: Final = Probe("user", lambda r: r.service and Seen(own=os.geteuid() == r.service[0], root=not os.geteuid()), (
    warning(lambda r: r.root and not r.own, f"all this is checked as root; the service runs as {SERVICE}",
            f"check outside this container, or give it SETUID and SETGID: root may not become {SERVICE} here"),
    warning(lambda r: not r.own, f"all this is checked as you; the service runs as {SERVICE}",
            "sudo hexapod-gateway check"),
), f"all this is checked as {SERVICE}, the service's user")
CLOCK: Final = Probe("clock", _clock, (
    warning(lambda r: r.adjtimex == _UNSYNCHRONISED, "is not synchronised",
            "switch time synchronisation on (timedatectl set-ntp true): certificates need a correct clock"),
), "is synchronised")
MACHINE: Final = (
    Probe("processor", lambda r: Seen(cpu=r.root / "sys/devices/system/cpu/cpu0/cpufreq"), (
        # Drivers that choose the clock in hardware give this name to a governor that does raise it.
        warning(lambda r: text(r.cpu / "scaling_governor") == "powersave"
                and not text(r.cpu / "scaling_driver").endswith("pstate"),
                f"its governor is powersave, which keeps it at its lowest clock: {_LATE}",
                "echo 'w /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor - - - - performance' | "
                "sudo tee /etc/tmpfiles.d/hexapod-governor.conf && sudo systemd-tmpfiles --create "
                "hexapod-governor.conf"),
    )),
    Probe("supply", _voltage, (
        warning(lambda r: r.low, "this Raspberry Pi's supply voltage is low: it may slow down, or restart",
                "use a supply of 5.1 V with enough current (a Pi 5: 5 A), and another supply for the servos"),
    )),
    Probe("memory", _memory, (
        warning(lambda r: r.free_mb < _LITTLE_MB,
                f"{{free_mb}} MB are free, and the service may need {_LITTLE_MB}: the kernel may end programs",
                "end the programs that need most: ps -eo rss,pid,comm --sort=-rss | head"),
    )),
    Probe("Wi-Fi", _wifi, (
        warning(lambda r: r.saves, "{wifi} saves power: commands arrive late and in bursts, which stops legs",
                f"printf '[connection]\\nwifi.powersave = 2\\n' | sudo tee {_NM} && "
                "sudo systemctl restart NetworkManager"),
    )),
    Probe("real-time", _realtime, (
        warning(lambda r: r.running == 0, f"the running service was granted none: {_LATE}",
                "see its journal; a kernel with CONFIG_RT_GROUP_SCHED may reject it"),
        warning(lambda r: r.rejected,
                f"priority {{priority}} is not granted ({{rejected}}; RLIMIT_RTPRIO is {{limit}}): {_LATE}",
                f"run it as the service, whose unit sets LimitRTPRIO ({INSTALL}); CONFIG_RT_GROUP_SCHED may reject it"),
    ), "priority {priority} is granted to {to}"),
)
UNIT: Final = Probe("systemd unit", _unit, (
    warning(lambda r: not r.systemd, "none: this machine does not run systemd",
            "each time the gateway ends, run `hexapod-gateway stop-servos`, then start it again"),
    warning(lambda r: not r.load, "systemctl shows nothing about it", f"try: systemctl status {SERVICE}"),
    warning(lambda r: r.load == "not-found", "is not installed: nothing stops the servos if the gateway dies", INSTALL),
    failure(lambda r: r.load != "loaded", "cannot be loaded ({load})", f"systemctl status {SERVICE} shows why"),
    failure(lambda r: r.program, f"{{program}} cannot be run: {_CANNOT_START}",
            f"install the package again, with what it depends on: {INSTALL}"),
    failure(lambda r: r.active == "failed", "has failed ({result})",
            f"journalctl -u {SERVICE} shows why; then: {RESTART}"),
    failure(lambda r: not r.stops, "runs no stop-servos after its end: nothing stops the servos if the gateway dies",
            f"see the drop-ins: systemctl cat {SERVICE}"),
    warning(lambda r: not r.enabled.startswith("enabled"), "is {active}, but does not start with the machine",
            f"sudo systemctl enable --now {SERVICE}"),
    warning(lambda r: r.active != "active", "is enabled, but {active}", f"sudo systemctl start {SERVICE}"),
), "is enabled and active")
PROBES: Final = (
    Probe("package", lambda r: (names(each, "/", kind=kind, again=whole.how_to_repeat(r.package))
                                for kind, each in r.files._asdict().items()), (
        failure(lambda r: r.kind == "changed",
                "not as installed: {some}. The service, or its Stops after a crash, may fail",
                "{again}"),
        warning(lambda r: r.kind == "added", "in the release, and not installed with it: {some}. Python may load it",
                "sudo rm {all}"),
        failure(lambda r: r.kind == "closed", "not readable by all, or writable by others than root: {some}",
                f"sudo chown root:root {{all}} && sudo chmod u+rw,go+r,go-w {{all}} && {RESTART}"),
    )),
    Probe("release", _release, (
        warning(lambda r: r.package != r.current, "{package} is installed, but {current} runs until no servo runs",
                "stop the robot, then: sudo dpkg-reconfigure {0}".replace("{0}", SERVICE)),
        warning(lambda r: r.runs != r.current, "the running service is {runs}, but {current} is installed",
                f"stop the robot, then: sudo systemctl restart {SERVICE}"),
        warning(lambda r: r.former, "{former[0]} is from the former installer: commands may be another release's",
                "sudo /usr/bin/hexapod-gateway setup"),
    )),
    Probe("user", _users, (
        failure(lambda _: True, f"there is no {{missing}}, so {_CANNOT_START}",
                f"sudo systemd-sysusers {SERVICE}.conf && sudo chgrp -f spi /dev/spidev*; {RESTART}"),
    )),
    Probe("unit file", _unit_file, (
        failure(lambda r: r.masked, f"{SERVICE} is masked, or its unit is empty: it cannot start",
                f"sudo rm -f /etc/systemd/system/{SERVICE}.service && sudo install -m 644 {{source}} {{place}} && "
                f"{_AFTER}"),
        failure(lambda r: r.other, "{found} replaces the package's unit (changes belong into a drop-in: "
                "systemctl edit)", f"stop the robot, then: sudo mv {{found}} {{found}}.off && {_AFTER}"),
        failure(lambda r: r.differs, "{place} differs from this release's (changes belong into a drop-in: systemctl "
                "edit)", f"stop the robot, then: sudo install -m 644 {{source}} {{place}} && {_AFTER}"),
    )),
    Probe("systemd unit", _reload, (
        failure(lambda r: r.unread, f"{SERVICE} was edited, but systemd still uses the old version",
                f"stop the robot, then: sudo systemctl daemon-reload && sudo systemctl restart {SERVICE}"),
    )),
    Probe("drop-in", _drop_ins, (  # named once, by its worst fault
        warning(lambda r: r.simulates, "{path} makes the controller a simulated one: the service moves no robot, and "
                "stops none after its end", f"before the robot is to move: {_ASIDE}"),
        failure(lambda r: r.emptied, "{path} empties ExecStopPost=: nothing stops the servos if the gateway dies",
                f"stop the robot, then put it aside: {_ASIDE}"),
        warning(lambda r: "HEXAPOD_" in r.environment,
                "{path} has settings that override gateway.toml: {environment}",
                f"move them to gateway.toml, stop the robot, then put it aside: {_ASIDE}"),
        warning(lambda r: r.depends, "{path} changes what Stops depend on: {depends}",
                f"if nobody knows why, stop the robot, then put it aside: {_ASIDE}"),
    ), "{path} sets {keys}"),
    Probe("variable", _variables, (
        warning(lambda _: True, "{name} is in the service's environment, but neither its unit nor a drop-in sets it",
                "take it out of DefaultEnvironment= in /etc/systemd/system.conf if it is there; stop the robot, then: "
                f"sudo systemctl daemon-reexec; sudo systemctl unset-environment {{name}}; {RESTART}"),
    )),
    Probe("settings", _new_settings, (), f"{ETC}/gateway.toml does not mention these, whose defaults hold: {{new}}"),
    Probe("state", _state, (
        failure(lambda r: not r.is_folder, f"{STATE_FOLDER} is no folder: {_CANNOT_START}",
                f"sudo mv {STATE_FOLDER} {STATE_FOLDER}.old && {RESTART}"),
        failure(lambda r: not r.own, f"the service may not write {STATE_FOLDER}: it may not start, nor stop the "
                "servos after its end", _OWN_STATE),
        warning(lambda r: r.kind in FORGETS, f"{STATE_FOLDER} is on {{kind}}, which a boot empties: calibration, "
                "revocations and the emergency stop are lost then",
                "keep the folder on a partition of its own (docs/robot.md)"),
        failure(lambda r: r.some, f"in {STATE_FOLDER}, the service may not read and write: {{some}}", _OWN_STATE),
    )),
    Probe("disk", _disks, (
        failure(lambda r: r.read_only, f"{{mount}} is mounted read-only: {_NOT_KEPT}",
                "see why (dmesg), then: sudo mount -o remount,rw {mount}"),
        failure(lambda r: r.free_mb < _LEAST_FREE_MB, f"{{mount}} has {{free_mb}} MB free: {_NOT_KEPT}",
                "find what fills it (sudo du -xh {mount} | sort -h | tail); to shorten the journal: "
                "sudo journalctl --vacuum-size=50M"),
        failure(lambda r: r.inodes < _LEAST_INODES, f"{{mount}} has room for {{inodes}} files: {_NOT_KEPT}",
                "find the folder with most files, and empty it: sudo du -x --inodes {mount} | sort -n | tail"),
    )),
    Probe("private key", _keys, (
        warning(lambda r: r.exposed, "not only root and the service may read {some}",
                "make a new one if others use this machine; else: "
                f"sudo chown root:{SERVICE} {{all}} && sudo chmod 640 {{all}}"),
        warning(lambda _: True, "{some} is the authority's key: a thief of this robot's card can make certificates for "
                "all its robots", "make sure that another machine has it, then: sudo shred -u {all}"),
    )),
)
# fmt: on
