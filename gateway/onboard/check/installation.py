"""Probes of the machine and the service: release, unit, drop-ins, user, state directory. They read as root.

`tests/box/test_check_faults.py` plants each fault and runs the remedy, from its first `sudo` to the line's end.
"""

import array
import fcntl
import grp
import os
import re
import shlex
import socket
import stat
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from gateway import certs
from gateway.errors import ConfigError
from gateway.host.directories import FORGETS, mount_of
from gateway.onboard import release_switch, whole
from gateway.onboard.check.table import LET_READ, RESTART, SERVICE, CheckedRobot, Result, failure, first, warning, well
from gateway.onboard.setup.machine import has_wrong_rights

GROUPS: Final = ("spi", "dialout", SERVICE)
"""Groups of the unit."""
_NOT_CONFIGURED: Final = ("unpacked", "half-configured", "triggers-pending", "triggers-awaited")
_STATE: Final = f"/var/lib/{SERVICE}"
_LEAST_FREE_MB, _LEAST_INODES = 20, 100
"""Room for some calibrations and lists."""
_RUN, _LEAST_RUN_MB = "/run", 1
"""In memory: a start writes a copy of gateway.toml there, and the black box's ring, which stays."""
_HARMLESS: Final = frozenset(
    ("Description", "After", "Wants", "Environment", "ReadWritePaths", "CPUWeight", "IOWeight", "LogLevelMax")
)
"""Keys that a drop-in may set. A Stop may depend on any other."""
_OURS: Final = re.compile(r"\b(?:HEXAPOD_|PYTHON|GATEWAY_(?!HANDOVER_))\w+")
"""Variables that change what the service does; what it hands to itself in a restart is none of them."""
_ASSIGNED: Final = re.compile(r"^[ \t]*(\w+)[ \t]*=[ \t]*(.*?)[ \t]*$", re.MULTILINE)
_ASK_POWER_SAVE, _DISABLED_BYTE = 0x8B2D, 21  # SIOCGIWPOWER; a struct iwreq begins with the name in 16 bytes

_TRUE: Final = ("true", "yes", "on", "with", "enable", "1")
"""What apt reads as true."""
_INSTALL: Final = f"sudo apt install ./{SERVICE}_VERSION_ARCH.deb"
_RELOAD: Final = "sudo systemctl daemon-reload"
_CANNOT_START: Final = "the service cannot start, nor stop the servos after its end"
_NO_STOP: Final = "nothing stops the servos if the gateway dies"
_NOT_KEPT: Final = "no calibration, emergency stop or list is kept"
_NEEDRESTART: Final = f"/etc/needrestart/conf.d/{SERVICE}.conf"
_REBOOTS: Final = re.compile(r"""^\s*Unattended-Upgrade::Automatic-Reboot\s+["']?(\w+)""", re.MULTILINE | re.IGNORECASE)
_NM: Final = "/etc/NetworkManager/conf.d/hexapod-wifi.conf"


# fmt: off
# ---- the machine


def machine(robot: CheckedRobot) -> Iterator[Result | None]:
    """Processor, supply and Wi-Fi."""
    cpu = "/sys/devices/system/cpu/cpu0/cpufreq/scaling_"
    # Drivers that choose the clock in hardware give this name to a governor that does raise it.
    slow = robot.text(f"{cpu}governor") == "powersave" and not robot.text(f"{cpu}driver").endswith("pstate")
    yield first("processor",
        warning(slow, "its governor is powersave, which keeps it at its lowest clock: a Stop may be late",
                "sudo tee /etc/tmpfiles.d/hexapod-governor.conf <<<'w /sys/devices/system/cpu/cpu*/cpufreq/"
                "scaling_governor - - - - performance' && sudo systemd-tmpfiles --create hexapod-governor.conf"))
    for hwmon in (f"/sys/class/hwmon/{each.name}" for each in robot.path("/sys/class/hwmon").glob("hwmon*")):
        low = robot.text(f"{hwmon}/name") == "rpi_volt" and robot.text(f"{hwmon}/in0_lcrit_alarm") == "1"
        yield first("supply",
            warning(low, "this Raspberry Pi's supply voltage is low: it may slow down, or restart",
                    "use a supply of 5.1 V with enough current (a Pi 5: 5 A), and another supply for the servos"))
    for wifi in (folder.parent.name for folder in robot.path("/sys/class/net").glob("*/phy80211")):
        asked = array.array("B", wifi.encode().ljust(32, b"\0"))
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
            fcntl.ioctl(any_socket, _ASK_POWER_SAVE, asked)
            yield first("Wi-Fi",
                warning(not asked[_DISABLED_BYTE], f"{wifi} saves power, so commands come in bursts, and legs stop",
                        f"sudo tee {_NM} <<<$'[connection]\\nwifi.powersave = 2' && sudo systemctl restart "
                        "NetworkManager"))


# ---- release and unit


def _named(paths: Iterable[Path | str]) -> tuple[str, str]:
    """Return the first few paths for a sentence, and all for a command; both are empty if there are none."""
    found = list(map(str, paths))
    rest = f" and {len(found) - whole.SHOWN} more" if len(found) > whole.SHOWN else ""
    return ", ".join(found[: whole.SHOWN]) + rest, shlex.join(found)


def release(robot: CheckedRobot) -> Iterator[Result | None]:
    """The package's files, the installed release, the one that `current` links to, and the one that is loaded."""
    package = whole.version()
    (changed, _), (added, every), (closed, each) = map(_named, whole.compare() if package else whole.Whole())
    yield first("package",
        failure(changed, f"not as installed: {changed}. The service, or its Stops after a crash, may fail",
                whole.how_to_repeat(package)),
        failure(closed, f"not readable by all, or writable by others than root: {closed}",
                f"sudo chown root:root {each} && sudo chmod u+rw,go+r,go-w {each} && {RESTART}"),
        warning(added, f"in the release, and not installed with it: {added}. Python may load it", f"sudo rm {every}"))
    link, process = robot.path(whole.CURRENT), robot.unit.get("MainPID", 0)
    wanted, _, status = whole.status().partition(" ")
    if link.is_dir():
        loaded = re.search(rf"{whole.LIBRARY}/([^/\s]+)/", robot.text(f"/proc/{process}/maps"))
        current = link.resolve().name.removesuffix(".kept")
        runs, package = loaded[1].removesuffix(".kept") if loaded else current, package or current
        yield first("release",
            failure(status == "half-installed" or wanted == "deinstall", f"{package} is only partly installed: dpkg "
                    "was interrupted", _INSTALL.replace("apt install", "dpkg --install")),  # apt rejects it
            failure(status in _NOT_CONFIGURED, f"{robot.text(release_switch.WHY) or f'{package} is {status}'}. So "
                    f"{current} goes on, and each apt command repeats the error",
                    f"fix what is named, then, with the robot stopped: {release_switch.CONFIGURE}"),
            warning(package != current, f"{package} is installed, but {current} runs: the upgrade waits until no servo "
                    "runs, or somebody went back",
                    f"stop the robot, then: sudo dpkg-reconfigure {SERVICE}"),
            warning(runs != current, f"the running service is {runs}, but {current} is installed",
                    f"stop the robot, then: sudo systemctl restart {SERVICE}"))


def unit_files(robot: CheckedRobot) -> Iterator[Result | None]:
    """The unit in force, compared with the release's. systemd does not notice a drop-in in a new folder."""
    place, source = f"/usr/lib/systemd/system/{SERVICE}.service", f"{whole.CURRENT}/units/{SERVICE}.service"
    others = [f"/{root}/systemd/system/{SERVICE}.service" for root in ("etc", "run")]
    other = next((each for each in others if os.path.lexists(robot.path(each))), "")  # a masked unit is a link there
    wanted, aside = robot.text(source), f"sudo mv {other} {other}.off && " if other else ""
    yield first("unit file",
        failure(wanted and (other or robot.text(place) != wanted), f"{other or place} is not this release's unit",
                f"stop the robot (changes belong into a drop-in), then: {aside}sudo install -m 644 {source} {place} && "
                f"{_RELOAD} && sudo systemctl enable {SERVICE} && {RESTART}"))
    folders = (robot.path(f"{each}.d") for each in others)
    there = {f"/{path.relative_to(robot.root)}" for folder in folders for path in folder.glob("*.conf")}
    unread = there - set(robot.unit.get("DropInPaths", "").split()) or robot.unit.get("NeedDaemonReload") == "yes"
    yield first("systemd unit",
        failure(robot.unit and unread, f"{SERVICE} was edited, but systemd still uses the old version",
                f"stop the robot, then: {_RELOAD} && sudo systemctl restart {SERVICE}"))


def unit(robot: CheckedRobot) -> Iterator[Result | None]:
    shows, needs = robot.unit, list[str]()
    load, active, enabled = (shows.get(f"{each}State", "") for each in ("Load", "Active", "UnitFile"))
    for path in re.findall(r"path=(\S+)", f"{shows.get('ExecStart')} {shows.get('ExecStopPost')}"):
        needs += [path, *re.findall(r"^#! *(\S+)", robot.text(path))]  # and its interpreter
    cannot_run = next((each for each in needs if not os.access(robot.path(each), os.X_OK)), "")
    if load != "masked":
        yield first("systemd unit",
            warning(load in ("", "not-found"), f"is not installed, or systemd does not run here: {_NO_STOP}",
                    "without systemd, run `hexapod-gateway stop-servos` each time the gateway ends; with it: "
                    f"{_INSTALL}"),
            failure(load != "loaded", f"cannot be loaded ({load})", f"systemctl status {SERVICE} shows why"),
            failure(cannot_run, f"{cannot_run} cannot be run: {_CANNOT_START}",
                    f"install the package again, with what it depends on: {_INSTALL}"),
            failure(active == "failed", f"has failed ({shows.get('Result')})",
                    f"journalctl -u {SERVICE} shows why; then: {RESTART}"),
            failure("stop-servos" not in shows.get("ExecStopPost", ""), f"runs no stop-servos after its end: "
                    f"{_NO_STOP}", f"see the drop-ins: systemctl cat {SERVICE}"),
            warning(not enabled.startswith("enabled") or active != "active", f"is {enabled or 'not enabled'} and "
                    f"{active}; it should be enabled and active", f"sudo systemctl enable --now {SERVICE}"),
            well("is enabled and active"))


def drop_ins(robot: CheckedRobot) -> Iterator[Result | None]:
    """Drop-ins, read as systemd does (a backslash at the end continues a line, # and ; begin comments), and variables
    of the service's process that neither unit nor drop-in sets."""
    for path in robot.unit.get("DropInPaths", "").split():
        assigned = _ASSIGNED.findall(robot.text(path).replace("\\\n", " "))
        environment = " ".join(value for key, value in assigned if key == "Environment")
        keys = {key for key, value in assigned if key != "DeviceAllow" or not value}  # a further device
        depends = ", ".join(sorted(keys - _HARMLESS | set(_OURS.findall(environment))))
        aside = f"stop the robot, then put it aside: sudo mv {path} {path}.off && {_RELOAD} && {RESTART}"
        yield first("drop-in",
            warning("--sim" in environment, f"{path} makes the controller a simulated one: the service moves no "
                    "robot, and stops none after its end", f"before the robot is to move, {aside}"),
            warning(depends, f"{path} changes settings, or what Stops depend on: {depends}",
                    f"move settings (HEXAPOD_…) to gateway.toml; if the rest is not needed, {aside}"),
            well(f"{path} sets {', '.join(sorted(keys))}"))
    process = robot.text(f"/proc/{robot.unit.get('MainPID', 0)}/environ").replace("\0", " ")
    for name in sorted(set(_OURS.findall(process)) - set(_OURS.findall(robot.unit.get("Environment", "")))):
        yield first("variable",
            warning(name, f"{name} is in the service's environment, but neither its unit nor a drop-in sets it",
                    "take it out of DefaultEnvironment= in /etc/systemd/system.conf if it is there; stop the robot, "
                    f"then: sudo systemctl daemon-reexec; sudo systemctl unset-environment {name}; {RESTART}"))


def restarts(robot: CheckedRobot) -> Iterator[Result | None]:
    """Other programs that would restart the service or the machine while a robot stands."""
    kept = re.search(rf"^[^#]*override_rc.*{SERVICE}.*= *0", robot.text(_NEEDRESTART), re.MULTILINE)
    yield first("needrestart",
        warning(robot.path("/usr/sbin/needrestart").exists() and not kept, "needrestart restarts the service after an "
                f"upgrade of a library, and the robot drops: {_NEEDRESTART} does not forbid it",
                f"sudo tee {_NEEDRESTART} <<< '$nrconf{{override_rc}}->{{qr(^{SERVICE}\\.service$)}} = 0;'"))
    parts = sorted(robot.path("/etc/apt/apt.conf.d").glob("*"), key=lambda each: each.name)
    stated = _REBOOTS.findall("\n".join(robot.text(each.relative_to(robot.root)) for each in parts))
    yield first("reboots",
        warning(stated and stated[-1].lower() in _TRUE, "unattended-upgrades reboots this machine after some upgrades, "
                "and the robot drops",
                "sudo tee /etc/apt/apt.conf.d/99-no-reboot <<< 'Unattended-Upgrade::Automatic-Reboot \"false\";'"))


# ---- user, files and disks


def users(robot: CheckedRobot) -> Iterator[Result | None]:
    """A missing user, or each missing group."""
    there = {each.gr_name for each in grp.getgrall()}
    groups = [f"group {each}" for each in GROUPS if each not in there]
    for missing in [f"user {SERVICE}"] if robot.service is None else groups:
        yield first("user",
            failure(missing, f"there is no {missing}, so {_CANNOT_START}",
                    f"sudo systemd-sysusers {SERVICE}.conf && sudo chgrp -f spi /dev/spidev*; {RESTART}"))


def state(robot: CheckedRobot) -> Iterator[Result | None]:
    """The state directory (the service's first start makes it), files in it that the service may not use, and disks."""
    folder = robot.path(_STATE)
    if robot.service is not None and folder.exists():
        not_own = list[Path]()
        for path in (folder, *folder.rglob("*")):
            with suppress(OSError):
                status, needed = path.lstat(), stat.S_IRWXU if path.is_dir() else stat.S_IRUSR | stat.S_IWUSR
                if status.st_uid != robot.service[0] or status.st_mode & needed != needed:
                    not_own.append(Path("/") / path.relative_to(robot.root))
        some, _ = _named(not_own)
        yield first("state",
            failure(not folder.is_dir(), f"{_STATE} is no folder: {_CANNOT_START}",
                    f"sudo mv {_STATE} {_STATE}.old && {RESTART}"),
            failure(some, f"the service may not read and write {some}: it may not start, nor stop the servos after its "
                    "end", f"sudo chown -R {SERVICE}: {_STATE} && sudo chmod -R u+rwX {_STATE} && {RESTART}"))
    for mount in dict.fromkeys(mount_of(each)[0] for each in (folder, robot.path(_RUN), robot.root)):
        disk, in_run = os.statvfs(mount), mount.endswith(_RUN)
        free_mb, inodes = disk.f_bavail * disk.f_frsize >> 20, disk.f_favail if disk.f_files else _LEAST_INODES
        result = "the service cannot start" if in_run else _NOT_KEPT
        full = free_mb < (_LEAST_RUN_MB if in_run else _LEAST_FREE_MB) or inodes < _LEAST_INODES
        yield first("disk",
            failure(disk.f_flag & os.ST_RDONLY, f"{mount} is mounted read-only: {result}",
                    f"dmesg shows why; then: sudo mount -o remount,rw {mount}"),
            failure(full, f"{mount} has {free_mb} MB free, and room for {inodes} files: {result}",
                    "delete what fills it (with du --inodes: most files), and restart; this lists it and shortens the "
                    f"journal: sudo du -xh {mount} | sort -h | tail; sudo journalctl --vacuum-size=50M"))


def state_disk(robot: CheckedRobot) -> Iterator[Result | None]:
    """Each file system of /etc/fstab that should hold the state, and is not mounted; one that a boot empties."""
    folder = Path(robot.settings.state.path or _STATE)
    kind = mount_of(folder)[1]
    yield first("state",
        warning(kind in FORGETS and robot.service, f"{folder} is on {kind}, which a boot empties: calibration, "
                "revocations and the emergency stop are lost then", "keep the state on a partition of its own "
                "(docs/robot.md, Keep the state over a boot)"))
    for disk, mount in (line.split()[:2] for line in robot.text("/etc/fstab").splitlines() if len(line.split()) > 1):
        holds = not disk.startswith("#") and folder.is_relative_to(mount)
        yield first("state",
            failure(holds and len(mount_of(folder)[0]) < len(mount), f"{disk} is not mounted on {mount}: calibration, "
                    "revocations and emergency stop on it are not used", f"see that {disk} is there (lsblk); with the "
                    f"robot stopped, then: sudo mount {mount} && {RESTART}"))


def private_keys(robot: CheckedRobot) -> Iterator[Result | None]:
    """Private keys that `setup` would close, and keys of an authority."""
    folder, service = robot.path(f"/etc/{SERVICE}"), robot.service
    found = sorted(path for path in folder.rglob("*.key") if path.is_file())
    some, _ = _named(each for each in found if service and has_wrong_rights(each, folder.stat().st_uid, service[1]))
    yield first("private key", warning(some, f"not only root and the service may read {some}", LET_READ))
    some, every = _named(each for each in found if re.fullmatch("(.*-)?ca", each.stem) or _is_of_authority(each))
    yield first("private key",
        warning(some, f"{some} is the authority's key: a thief of it can admit anyone to all its robots",
                f"make sure that another machine has it, then: sudo shred -u {every}"))


def _is_of_authority(key: Path) -> bool:
    """Return whether the certificate next to it is an authority's with this key."""
    with suppress(ConfigError):
        ca = key.with_name("ca.pem")
        return not certs.folder.mismatch(ca, ca, key, of_robot=False)
    return False


# fmt: on
AS_ROOT: Final = (release, users, unit_files, drop_ins, state, private_keys)
"""Probes that need root's rights."""
