"""Probes of the machine and the service: release, unit, drop-ins, user, state directory. They read as root.

`tests/box/test_check_faults.py` plants each fault and runs the remedy, from its first `sudo` to the line's end.
"""

import array
import fcntl
import grp
import importlib.metadata
import os
import platform
import re
import shlex
import shutil
import socket
import stat
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from gateway import certs
from gateway.errors import ConfigError
from gateway.host.kernel_tables import FORGETS, mount_of
from gateway.onboard import whole
from gateway.onboard.check.table import RESTART, SERVICE, CheckedRobot, Probes, Rows, failure, text, warning, well

_NEEDED: Final = ("spi", "dialout", SERVICE)
"""Groups of the unit."""
_STATE: Final = f"/var/lib/{SERVICE}"
_FORMER: Final = (f"/usr/local/bin/{SERVICE}", f"/opt/{SERVICE}")
_SHEBANG: Final = 127
"""Bytes of a first line that Linux reads."""
_MOST_FILES: Final = 20_000
"""Most files read of the state directory."""
_LEAST_FREE_MB, _LEAST_INODES = 20, 100
"""Room for some calibrations and lists."""
_HARMLESS: Final = frozenset(
    ("Description", "After", "Wants", "Environment", "ReadWritePaths", "CPUWeight", "IOWeight", "LogLevelMax")
)
"""Keys that a drop-in may set. A Stop may depend on any other."""
_OURS: Final = re.compile(r"\b(?:HEXAPOD_|PYTHON|GATEWAY_)\w+")
"""Variables that change what the service does."""
_ASSIGNED: Final = re.compile(r"^[ \t]*(\w+)[ \t]*=[ \t]*(.*?)[ \t]*$", re.MULTILINE)
_ASK_POWER_SAVE, _DISABLED_BYTE = 0x8B2D, 21  # SIOCGIWPOWER; a struct iwreq begins with the name in 16 bytes

_INSTALL: Final = f"sudo apt install ./{SERVICE}_VERSION_ARCH.deb"
_RELOAD: Final = "sudo systemctl daemon-reload"
_AFTER: Final = f"{_RELOAD} && sudo systemctl enable {SERVICE} && {RESTART}"
_CANNOT_START: Final = "the service cannot start, nor stop the servos after its end"
_NO_STOP: Final = "nothing stops the servos if the gateway dies"
_NOT_KEPT: Final = "no calibration, emergency stop or list is kept"
_LATE: Final = "on a busy machine a Stop may be late"


# ---- the machine


def _python(_: CheckedRobot) -> Iterator[Rows]:
    zenoh = importlib.metadata.version("eclipse-zenoh")
    yield [well(f"{platform.python_version()} with eclipse-zenoh {zenoh}, {sys.executable}")]


def _rights(robot: CheckedRobot) -> Iterator[Rows]:
    if robot.service is not None:
        own, root = os.geteuid() == robot.service[0], not os.geteuid()
        yield [
            warning(root and not own, f"all this is checked as root; the service runs as {SERVICE}",
                    f"check outside this container, or give it SETUID and SETGID: root may not become {SERVICE} here"),
            warning(not own, f"all this is checked as you; the service runs as {SERVICE}",
                    "sudo hexapod-gateway check"),
            well(f"all this is checked as {SERVICE}, the service's user"),
        ]  # fmt: skip


def _processor(robot: CheckedRobot) -> Iterator[Rows]:
    cpu = robot.path("/sys/devices/system/cpu/cpu0/cpufreq")
    # Drivers that choose the clock in hardware give this name to a governor that does raise it.
    slow = text(cpu / "scaling_governor") == "powersave" and not text(cpu / "scaling_driver").endswith("pstate")
    yield [
        warning(slow, f"its governor is powersave, which keeps it at its lowest clock: {_LATE}",
                "echo 'w /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor - - - - performance' | "
                "sudo tee /etc/tmpfiles.d/hexapod-governor.conf && sudo systemd-tmpfiles --create "
                "hexapod-governor.conf"),
    ]  # fmt: skip


def _supply(robot: CheckedRobot) -> Iterator[Rows]:
    for name in robot.path("/sys/class/hwmon").glob("hwmon*/name"):
        low = text(name) == "rpi_volt" and text(name.with_name("in0_lcrit_alarm")) == "1"
        yield [
            warning(low, "this Raspberry Pi's supply voltage is low: it may slow down, or restart",
                    "use a supply of 5.1 V with enough current (a Pi 5: 5 A), and another supply for the servos"),
        ]  # fmt: skip


def _wifi(robot: CheckedRobot) -> Iterator[Rows]:
    for wifi in (folder.parent.name for folder in robot.path("/sys/class/net").glob("*/phy80211")):
        asked = array.array("B", wifi.encode().ljust(32, b"\0"))
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
            fcntl.ioctl(any_socket, _ASK_POWER_SAVE, asked)
            conf = "/etc/NetworkManager/conf.d/hexapod-wifi.conf"
            yield [
                warning(not asked[_DISABLED_BYTE], f"{wifi} saves power: commands arrive late and in bursts, which "
                        f"stops legs", f"printf '[connection]\\nwifi.powersave = 2\\n' | sudo tee {conf} && "
                        "sudo systemctl restart NetworkManager"),
            ]  # fmt: skip


def _realtime(robot: CheckedRobot) -> Iterator[Rows]:
    """The priority that the kernel granted the running service."""
    with suppress(OSError):
        threads = [int(each.name) for each in Path(f"/proc/{robot.unit.get('MainPID', 0)}/task").iterdir()]
        priority = max(os.sched_getparam(each).sched_priority for each in threads)
        yield [
            warning(not priority, f"the running service was granted none: {_LATE}",
                    f"its unit sets LimitRTPRIO ({_INSTALL}); a kernel with CONFIG_RT_GROUP_SCHED may reject it"),
            well(f"priority {priority} is granted to the service that runs"),
        ]  # fmt: skip


# ---- release and unit


def _named(found: Sequence[Path | str]) -> tuple[str, str]:
    """Return the first few paths for a sentence, and all for a command; both are empty if there are none."""
    rest = f" and {len(found) - whole.SHOWN} more" if len(found) > whole.SHOWN else ""
    return ", ".join(map(str, found[: whole.SHOWN])) + rest, shlex.join(map(str, found))


def _package(robot: CheckedRobot) -> Iterator[Rows]:
    (changed, _), (added, every), (closed, each) = map(_named, robot.files)
    yield [failure(changed, f"not as installed: {changed}. The service, or its Stops after a crash, may fail",
                   whole.how_to_repeat(robot.package))]  # fmt: skip
    yield [warning(added, f"in the release, and not installed with it: {added}. Python may load it",
                   f"sudo rm {every}")]  # fmt: skip
    yield [failure(closed, f"not readable by all, or writable by others than root: {closed}",
                   f"sudo chown root:root {each} && sudo chmod u+rw,go+r,go-w {each} && {RESTART}")]  # fmt: skip


def _release(robot: CheckedRobot) -> Iterator[Rows]:
    """The installed release, the one that `current` links to, and the one that the service has loaded."""
    link = robot.path(whole.CURRENT)
    if not link.is_dir():
        return
    maps = text(robot.path(f"/proc/{robot.unit.get('MainPID', 0)}/maps"))
    loaded, current = re.search(rf"{whole.LIBRARY}/([^/\s]+)/", maps), link.resolve().name.removesuffix(".kept")
    runs, package = loaded[1].removesuffix(".kept") if loaded else current, robot.package or current
    former = next((each for each in _FORMER if robot.path(each).exists()), "")
    yield [
        warning(package != current, f"{package} is installed, but {current} runs until no servo runs",
                f"stop the robot, then: sudo dpkg-reconfigure {SERVICE}"),
        warning(runs != current, f"the running service is {runs}, but {current} is installed",
                f"stop the robot, then: sudo systemctl restart {SERVICE}"),
        warning(former, f"{former} is from the former installer: commands may be another release's",
                "sudo /usr/bin/hexapod-gateway setup"),
    ]  # fmt: skip


def _unit_file(robot: CheckedRobot) -> Iterator[Rows]:
    """The unit in force, compared with that of the release."""
    place, source = f"/usr/lib/systemd/system/{SERVICE}.service", f"{whole.CURRENT}/units/{SERVICE}.service"
    wanted, found = text(robot.path(source)), robot.unit.get("FragmentPath", "")
    if wanted:
        masked = robot.unit.get("LoadState") == "masked" or (found and not text(robot.path(found)))
        other = found and robot.path(found).resolve() != robot.path(place).resolve()
        rights, anew = "(changes belong into a drop-in: systemctl edit)", f"sudo install -m 644 {source} {place}"
        yield [
            failure(masked, f"{SERVICE} is masked, or its unit is empty: it cannot start",
                    f"sudo rm -f /etc/systemd/system/{SERVICE}.service && {anew} && {_AFTER}"),
            failure(other, f"{found} replaces the package's unit {rights}",
                    f"stop the robot, then: sudo mv {found} {found}.off && {_AFTER}"),
            failure(wanted != text(robot.path(place)), f"{place} differs from this release's {rights}",
                    f"stop the robot, then: {anew} && {_AFTER}"),
        ]  # fmt: skip


def _unit(robot: CheckedRobot) -> Iterator[Rows]:
    unit, needs = robot.unit, list[str]()
    load, active = unit.get("LoadState", ""), unit.get("ActiveState", "")
    for path in re.findall(r"path=(\S+)", f"{unit.get('ExecStart')} {unit.get('ExecStopPost')}"):
        needs += [path, *re.findall(r"^#! *(\S+)", text(robot.path(path))[:_SHEBANG])]  # and its interpreter
    cannot_run = next((each for each in needs if not os.access(robot.path(each), os.X_OK)), "")
    yield [] if load == "masked" else [
        warning(not (robot.path("/run/systemd/system").is_dir() and shutil.which("systemctl")),
                "none: this machine does not run systemd",
                "each time the gateway ends, run `hexapod-gateway stop-servos`, then start it again"),
        warning(not load, "systemctl shows nothing about it", f"try: systemctl status {SERVICE}"),
        warning(load == "not-found", f"is not installed: {_NO_STOP}", _INSTALL),
        failure(load != "loaded", f"cannot be loaded ({load})", f"systemctl status {SERVICE} shows why"),
        failure(cannot_run, f"{cannot_run} cannot be run: {_CANNOT_START}",
                f"install the package again, with what it depends on: {_INSTALL}"),
        failure(active == "failed", f"has failed ({unit.get('Result')})",
                f"journalctl -u {SERVICE} shows why; then: {RESTART}"),
        failure("stop-servos" not in unit.get("ExecStopPost", ""), f"runs no stop-servos after its end: {_NO_STOP}",
                f"see the drop-ins: systemctl cat {SERVICE}"),
        warning(not unit.get("UnitFileState", "").startswith("enabled"),
                f"is {active}, but does not start with the machine", f"sudo systemctl enable --now {SERVICE}"),
        warning(active != "active", f"is enabled, but {active}", f"sudo systemctl start {SERVICE}"),
        well("is enabled and active"),
    ]  # fmt: skip


def _reload(robot: CheckedRobot) -> Iterator[Rows]:
    """Units and drop-ins that systemd has not reloaded. It does not notice a drop-in in a new folder."""
    folders = (robot.path(f"/{root}/systemd/system/{SERVICE}.service.d") for root in ("etc", "run"))
    found = {f"/{path.relative_to(robot.root)}" for folder in folders for path in folder.glob("*.conf")}
    unread = found - set(robot.unit.get("DropInPaths", "").split()) or robot.unit.get("NeedDaemonReload") == "yes"
    again = f"stop the robot, then: {_RELOAD} && sudo systemctl restart {SERVICE}"
    yield [failure(robot.unit and unread, f"{SERVICE} was edited, but systemd still uses the old version", again)]


def _drop_ins(robot: CheckedRobot) -> Iterator[Rows]:
    """Read as systemd does: a backslash at the end continues a line, # and ; begin comments."""
    for path in robot.unit.get("DropInPaths", "").split():
        assigned = _ASSIGNED.findall(text(robot.path(path)).replace("\\\n", " "))
        environment = " ".join(value for key, value in assigned if key == "Environment")
        after, keys = [value for key, value in assigned if key == "ExecStopPost"], {key for key, _ in assigned}
        emptied = "" in after and not any("stop-servos" in each for each in after[after.index("") :])
        depends = ", ".join(sorted(keys - _HARMLESS | set(re.findall(r"\bPYTHON\w+", environment))))
        aside = f"stop the robot, then put it aside: sudo mv {path} {path}.off && {_RELOAD} && {RESTART}"
        yield [
            warning("--sim" in environment, f"{path} makes the controller a simulated one: the service moves no "
                    "robot, and stops none after its end", f"before the robot is to move, {aside}"),
            failure(emptied, f"{path} empties ExecStopPost=: {_NO_STOP}", aside),
            warning("HEXAPOD_" in environment, f"{path} has settings that override gateway.toml: {environment}",
                    f"move them to gateway.toml, {aside}"),
            warning(depends, f"{path} changes what Stops depend on: {depends}",
                    f"if nobody knows why, {aside}"),
            well(f"{path} sets {', '.join(sorted(keys))}"),
        ]  # fmt: skip


def _variables(robot: CheckedRobot) -> Iterator[Rows]:
    """Variables of the service, or of its process, that neither unit nor drop-in sets."""
    process = text(robot.path(f"/proc/{robot.unit.get('MainPID', 0)}/environ")).replace("\0", " ")
    theirs = set(_OURS.findall(f"{robot.environment} {process}"))
    for name in sorted(theirs - set(_OURS.findall(robot.unit.get("Environment", "")))):
        yield [
            warning(name, f"{name} is in the service's environment, but neither its unit nor a drop-in sets it",
                    "take it out of DefaultEnvironment= in /etc/systemd/system.conf if it is there; stop the robot, "
                    f"then: sudo systemctl daemon-reexec; sudo systemctl unset-environment {name}; {RESTART}"),
        ]  # fmt: skip


# ---- user, files and disks


def _users(robot: CheckedRobot) -> Iterator[Rows]:
    """A missing user, or each missing group."""
    there = {each.gr_name for each in grp.getgrall()}
    groups = [f"group {each}" for each in _NEEDED if each not in there]
    for missing in [f"user {SERVICE}"] if robot.service is None else groups:
        anew = f"sudo systemd-sysusers {SERVICE}.conf && sudo chgrp -f spi /dev/spidev*; {RESTART}"
        yield [failure(missing, f"there is no {missing}, so {_CANNOT_START}", anew)]


def _state(robot: CheckedRobot) -> Iterator[Rows]:
    """The state directory, and files in it that the service does not own or may not read and write.

    Nothing if it does not exist: the service's first start makes it.
    """
    folder = robot.path(_STATE)
    if robot.service is None or not folder.exists():
        return
    kind, own = mount_of(folder)[1], folder.is_dir() and _is_own(folder.resolve(), robot)
    anew = f"sudo chown -R {SERVICE}:{SERVICE} {_STATE} && sudo chmod -R u+rwX {_STATE} && {RESTART}"
    yield [
        failure(not folder.is_dir(), f"{_STATE} is no folder: {_CANNOT_START}",
                f"sudo mv {_STATE} {_STATE}.old && {RESTART}"),
        failure(not own, f"the service may not write {_STATE}: it may not start, nor stop the servos after its end",
                anew),
        warning(kind in FORGETS, f"{_STATE} is on {kind}, which a boot empties: calibration, revocations and the "
                "emergency stop are lost then", "keep the folder on a partition of its own (docs/robot.md)"),
    ]  # fmt: skip
    others = list[Path]()
    for path, _ in zip(folder.rglob("*") if own else (), range(_MOST_FILES), strict=False):
        with suppress(OSError):
            others += [] if _is_own(path, robot) else [path.relative_to(folder)]
    some, _ = _named(others)
    yield [failure(others, f"in {_STATE}, the service may not read and write: {some}", anew)]


def _is_own(path: Path, robot: CheckedRobot) -> bool:
    status = path.lstat()
    needed = stat.S_IRWXU if stat.S_ISDIR(status.st_mode) else stat.S_IRUSR | stat.S_IWUSR
    return status.st_uid == (robot.service or (-1,))[0] and status.st_mode & needed == needed


def _disks(robot: CheckedRobot) -> Iterator[Rows]:
    """The file systems of the state directory and of the root."""
    for mount in dict.fromkeys(mount_of(each)[0] for each in (robot.path(_STATE), robot.root)):
        disk = os.statvfs(mount)
        free_mb, inodes = disk.f_bavail * disk.f_frsize >> 20, disk.f_favail if disk.f_files else _LEAST_INODES
        yield [
            failure(disk.f_flag & os.ST_RDONLY, f"{mount} is mounted read-only: {_NOT_KEPT}",
                    f"see why (dmesg), then: sudo mount -o remount,rw {mount}"),
            failure(free_mb < _LEAST_FREE_MB, f"{mount} has {free_mb} MB free: {_NOT_KEPT}",
                    f"find what fills it (sudo du -xh {mount} | sort -h | tail); to shorten the journal: "
                    "sudo journalctl --vacuum-size=50M"),
            failure(inodes < _LEAST_INODES, f"{mount} has room for {inodes} files: {_NOT_KEPT}",
                    f"find the folder with most files, and empty it: sudo du -x --inodes {mount} | sort -n | tail"),
        ]  # fmt: skip


def _keys(robot: CheckedRobot) -> Iterator[Rows]:
    """Private keys that others may read by the file's own mode, and keys of an authority, found by name or by the
    certificate next to them."""
    found = sorted(path for path in robot.path(f"/etc/{SERVICE}").rglob("*.key") if path.is_file())
    some, every = _named([each for each in found if _exposed(each.stat(), robot)])
    yield [warning(some, f"not only root and the service may read {some}",
                   "make a new one if others use this machine; else: "
                   f"sudo chown root:{SERVICE} {every} && sudo chmod 640 {every}")]  # fmt: skip
    some, every = _named([each for each in found if re.fullmatch("(.*-)?ca", each.stem) or _is_of_authority(each)])
    yield [warning(some, f"{some} is the authority's key: a thief of this robot's card can make certificates for all "
                   "its robots", f"make sure that another machine has it, then: sudo shred -u {every}")]  # fmt: skip


def _exposed(status: os.stat_result, robot: CheckedRobot) -> bool:
    user, group = robot.service or (status.st_uid, status.st_gid)
    others = status.st_mode & 0o007 or (status.st_mode & 0o060 and status.st_gid not in (0, group))
    return bool(others) or status.st_uid not in (0, user)


def _is_of_authority(key: Path) -> bool:
    with suppress(ConfigError):
        public = certs.files.read_key(key).public_key()
        return any(public == each.public_key() for each in certs.files.read_certificates(key.with_name("ca.pem")))
    return False


PYTHON: Final[Probes] = {"Python": _python}
RIGHTS: Final[Probes] = {"user": _rights}
UNIT: Final[Probes] = {"systemd unit": _unit}
MACHINE: Final[Probes] = {
    "processor": _processor, "supply": _supply, "Wi-Fi": _wifi, "real-time": _realtime,
}  # fmt: skip
PROBES: Final[Probes] = {
    "package": _package, "release": _release, "user": _users, "unit file": _unit_file, "systemd unit": _reload,
    "drop-in": _drop_ins, "variable": _variables, "state": _state, "disk": _disks, "private key": _keys,
}  # fmt: skip
