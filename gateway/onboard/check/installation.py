"""An installed service: release, files, units, drop-ins, users and folders. Root sees all of it.

`tests/box/test_check_faults.py` plants each fault and follows the remedy, from its first `sudo` to the line's end.
"""

import grp
import os
import pwd
import shlex
import stat
import subprocess
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Final, NamedTuple

from gateway import certs
from gateway.errors import ConfigError
from gateway.onboard import whole
from gateway.onboard.check import machine
from gateway.onboard.check.table import (
    ETC,
    RESTART,
    SERVICE,
    Fault,
    Probe,
    Result,
    Seen,
    Verdict,
    always,
    failure,
    results,
    warning,
)  # fmt: skip
from gateway.onboard.whole import SHOWN, Whole

STATE_FOLDER: Final = f"/var/lib/{SERVICE}"
_COMMAND: Final = f"/usr/local/bin/{SERVICE}"
_PROPERTIES: Final = "LoadState,ActiveState,SubState,UnitFileState,NeedDaemonReload,DropInPaths"
_GROUPS: Final = ("spi", SERVICE)
_MOST_FILES: Final = 20_000
"""Of the state directory: a look ends in any case."""
_LEAST_FREE_MB: Final = 20
"""For some calibrations and lists."""
_LEAST_INODES: Final = 100
_FORGETS: Final = frozenset({"overlay", "tmpfs", "ramfs"})
"""File systems that are empty, or as before, after a boot."""


class Shipped(NamedTuple):
    """A file that the installer copies out of the release, which has it under `source`. `after` makes it effective."""

    source: str
    place: str
    after: str


SHIPPED: Final = (
    Shipped(
        f"systemd/{SERVICE}.service", f"/etc/systemd/system/{SERVICE}.service",
        f"sudo systemctl daemon-reload && sudo systemctl enable {SERVICE} && {RESTART}",
    ),
    Shipped(
        f"udev/60-{SERVICE}.rules", f"/etc/udev/rules.d/60-{SERVICE}.rules",
        "sudo udevadm control --reload; sudo udevadm trigger --subsystem-match=spidev",
    ),
)  # fmt: skip
# fmt: off
_DEPENDS: Final = frozenset({
    "Type", "NotifyAccess", "User", "Group", "DynamicUser", "SupplementaryGroups", "RootDirectory",
    "WorkingDirectory", "ExecStart", "ExecStartPre", "ExecStop", "ExecStopPost", "RuntimeDirectory",
    "RuntimeDirectoryMode", "RuntimeDirectoryPreserve", "StateDirectory", "StateDirectoryMode", "WatchdogSec",
    "WatchdogSignal", "KillMode", "KillSignal", "FinalKillSignal", "SendSIGKILL", "Restart", "RestartSec",
    "RestartPreventExitStatus", "TimeoutStartSec", "TimeoutStopSec", "TimeoutAbortSec", "TimeoutSec", "LimitRTPRIO",
    "LimitNICE", "Nice", "DevicePolicy", "DeviceAllow", "PrivateDevices", "SystemCallFilter", "RestrictRealtime",
    "CPUQuota", "CPUSchedulingPolicy", "EnvironmentFile", "ReadOnlyPaths", "InaccessiblePaths", "LimitNOFILE",
    "MemoryMax",
})
# fmt: on
"""What the service's Stops, or those after its end, depend on; else a person may change what they like."""


class Installation:
    """What the probes look at, below `root`."""

    def __init__(self, root: Path = Path("/")) -> None:
        self.root = root
        self.link = self.path(str(whole.INSTALLED))
        self.release = self.link.resolve()
        self.again = whole.how_to_repeat(self.release)

    def path(self, absolute: str) -> Path:
        """A path of the machine."""
        return self.root / absolute.lstrip("/")

    @cached_property
    def deploy(self) -> Path:
        """The files that the release ships."""
        return next(self.release.glob("lib/python*/site-packages/gateway/deploy"), self.release / "deploy")

    @cached_property
    def whole(self) -> Whole:
        """The release, compared with its list."""
        return whole.compare(self.release)

    @cached_property
    def service(self) -> tuple[int, int] | None:
        """User and group of the service; None where there is no such user."""
        with suppress(KeyError):
            found = pwd.getpwnam(SERVICE)
            return found.pw_uid, found.pw_gid
        return None

    @cached_property
    def groups(self) -> Sequence[str]:
        """Of the groups that are needed, those that exist."""
        return [each.gr_name for each in grp.getgrall() if each.gr_name in _GROUPS]

    @cached_property
    def unit(self) -> dict[str, str]:
        """What systemd shows of the service; nothing where it shows nothing."""
        try:
            shown = machine.show(f"{SERVICE}.service", _PROPERTIES)
        except (OSError, subprocess.SubprocessError):
            return {}
        # systemd does not notice a drop-in in a folder that is new.
        folders = (self.path(f"{root}/systemd/system/{SERVICE}.service.d") for root in ("etc", "run"))
        found = {str(path) for folder in folders for path in folder.glob("*.conf")}
        if not found <= set(shown.get("DropInPaths", "").split()):
            shown["NeedDaemonReload"] = "yes"
        return shown


def look(root: Path = Path("/")) -> list[Result] | None:
    """The lines about an installation; None where no service is installed."""
    found = Installation(root)
    if not found.link.is_dir():
        return None
    lines = list(results(PROBES, found))
    return lines or [Result("installation", Verdict.OK, f"{found.release}, each file as installed")]


# ---- what the probes read

Reading = Callable[[Installation], Iterable[Seen]]


def _some(names: Callable[[Installation], Sequence[str]]) -> Reading:
    """A few names in one sentence."""

    def read(look: Installation) -> Iterator[Seen]:
        found = names(look)
        if found:
            more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
            paths = found if found[0].startswith("/") else [f"{look.release}/{each}" for each in found]
            shown = f"{', '.join(found[:SHOWN])}{more}"
            yield Seen(some=shown, again=look.again, release=look.release, all=shlex.join(paths))

    return read


def _command(look: Installation) -> Iterator[Seen]:
    path, wanted = look.path(_COMMAND), look.link / "bin" / SERVICE
    leads = f"leads to {path.resolve()}" if os.path.lexists(path) else "is missing"
    yield Seen(other=path.resolve() != wanted.resolve() or not os.path.lexists(path), leads=leads)


def _users(look: Installation) -> Iterator[Seen]:
    """The user, and each group that is missing."""
    yield Seen(missing=look.service is None, again=look.again, group="")
    yield from (Seen(missing=False, group=each) for each in _GROUPS if look.service and each not in look.groups)


def _shipped(look: Installation) -> Iterator[Seen]:
    """A damaged release is another line."""
    for each in SHIPPED:
        source = look.deploy / each.source
        wanted, found = _content(source), _content(look.path(each.place))
        yield Seen(
            place=each.place, source=source, after=each.after, differs=bool(wanted) and found != wanted,
            masked=each is SHIPPED[0] and look.unit.get("LoadState") == "masked",
            how="is missing" if found is None else "is not as this release has it",
        )  # fmt: skip


def _content(path: Path) -> bytes | None:
    with suppress(OSError):
        return path.read_bytes()
    return None


def _reload(look: Installation) -> Iterator[Seen]:
    yield Seen(reload=look.unit.get("NeedDaemonReload"))


def _drop_ins(look: Installation) -> Iterator[Seen]:
    """Read as systemd does: a backslash at the end continues a line, # and ; begin comments."""
    for path in look.unit.get("DropInPaths", "").split():
        text = (_content(look.path(path)) or b"").decode(errors="replace").replace("\\\n", " ")
        lines = [line.strip() for line in text.splitlines() if line.strip() and line.strip()[0] not in "#;["]
        assigned = [(key.strip(), value.strip()) for key, _, value in (line.partition("=") for line in lines)]
        environment = " ".join(value for key, value in assigned if key == "Environment")
        after = [value for key, value in assigned if key == "ExecStopPost"]
        emptied = "" in after and not any("stop-servos" in each for each in after[after.index("") :])
        python = {name.partition("=")[0] for name in environment.split() if name.startswith("PYTHON")}
        yield Seen(
            path=path, environment=environment, emptied=emptied, simulates="--sim" in environment,
            depends=", ".join(sorted({key for key, _ in assigned} & _DEPENDS | python)),
        )  # fmt: skip


def _state(look: Installation) -> Iterator[Seen]:
    """The state directory; nothing where the service's first start makes it."""
    folder = look.path(STATE_FOLDER)
    if look.service is None or not folder.exists():
        return
    status, disk = folder.stat(), os.statvfs(folder)
    mount, kind = mount_of(folder)
    yield Seen(
        is_folder=stat.S_ISDIR(status.st_mode), mount=mount, kind=kind, forgets=kind in _FORGETS,
        read_only=bool(disk.f_flag & os.ST_RDONLY), free_mb=disk.f_bavail * disk.f_frsize >> 20,
        inodes=disk.f_favail if disk.f_files else _LEAST_INODES,
        own=status.st_uid == look.service[0] and status.st_mode & stat.S_IRWXU == stat.S_IRWXU,
    )  # fmt: skip


def mount_of(path: Path) -> tuple[str, str]:
    """Where its file system is mounted, and of which kind it is, by the kernel's list.

    A bind mount is on the same device as what is above it.
    """
    lines = (line.split() for line in Path("/proc/self/mountinfo").read_text().splitlines())
    mounts = [(words[4].replace("\\040", " "), words[words.index("-") + 1]) for words in lines]
    return max((each for each in mounts if path.is_relative_to(each[0])), key=lambda each: len(each[0]))


def _foreign(look: Installation) -> list[str]:
    """What another user owns in the state directory, or its owner may not read and write."""
    folder, found, count = look.path(STATE_FOLDER), list[str](), 0
    if look.service is None or not folder.is_dir() or folder.stat().st_uid != look.service[0]:
        return found
    for parent, folders, files in os.walk(folder):
        for path in (Path(parent, name) for name in (*folders, *files)):
            count += 1
            if count > _MOST_FILES:
                return found
            with suppress(OSError):
                status = path.lstat()
                needed = stat.S_IRWXU if stat.S_ISDIR(status.st_mode) else stat.S_IRUSR | stat.S_IWUSR
                if status.st_uid != look.service[0] or status.st_mode & needed != needed:
                    found.append(str(path.relative_to(folder)))
    return found


def _keys(look: Installation) -> list[Path]:
    return sorted(path for path in look.path(ETC).rglob("*.key") if path.is_file())


def _exposed(look: Installation) -> list[str]:
    """By the file's own rights (a copy or a backup may lie in a folder that is open): others than root and the
    service own it, or may read it."""

    def exposed(status: os.stat_result) -> bool:
        user, group = look.service or (status.st_uid, status.st_gid)
        others = status.st_mode & 0o007 or (status.st_mode & 0o060 and status.st_gid not in (0, group))
        return bool(others) or status.st_uid not in (0, user)

    return [str(key) for key in _keys(look) if exposed(key.stat())]


def _authority_keys(look: Installation) -> list[str]:
    """Private keys of an authority, by their names as `certs` gives them, or by the certificate next to them."""
    return [
        str(key)
        for key in _keys(look)
        if key.stem == "ca" or key.stem.endswith("-ca") or _is_of(key, key.with_name("ca.pem"))
    ]


def _is_of(key: Path, certificate: Path) -> bool:
    with suppress(ConfigError):
        public = certs.files.read_key(key).public_key()
        return any(public == each.public_key() for each in certs.files.read_certificates(certificate))
    return False


# ---- the table

_ASIDE: Final = f"sudo mv {{path}} {{path}}.off && sudo systemctl daemon-reload && {RESTART}"
_OWN_STATE: Final = (
    f"sudo chown -R {SERVICE}:{SERVICE} {STATE_FOLDER} && sudo chmod -R u+rwX {STATE_FOLDER} && {RESTART}"
)
_CANNOT_START: Final = "the service cannot start, nor stop the servos after its end"


def _wrong(name: str, read: Reading, *faults: Fault) -> Probe:
    """Nothing is printed where all is well."""
    return Probe(name, read, faults)


# fmt: off
PROBES: Final = (
    _wrong("release", _some(lambda look: look.whole.changed), failure(always,
           "not as installed in {release}: {some}. The service, or its Stops after a crash, may fail", "{again}")),
    _wrong("release", _some(lambda look: look.whole.added), warning(always,
           "in {release}, and not installed with it: {some}. Python may load it", "sudo rm {all}")),
    _wrong("release", _some(lambda look: look.whole.closed), failure(always,
           "in {release}, not for all to read, or not for root alone to write: {some}",
           f"sudo chown -R root:root {{release}} && sudo chmod -R u+rwX,go+rX,go-w {{release}} && {RESTART}")),
    _wrong("command", _command, warning(lambda r: r.other,
           f"{_COMMAND} {{leads}}: commands are another release's than the service",
           f"sudo ln -sfnT {whole.INSTALLED}/bin/{SERVICE} {_COMMAND}")),
    _wrong("user", _users,
           failure(lambda r: r.missing, f"there is no user {SERVICE}, so {_CANNOT_START}", "{again}"),
           failure(lambda r: r.group, f"there is no group {{group}}, so {_CANNOT_START}",
                   f"sudo groupadd --system {{group}} && sudo usermod -aG {{group}} {SERVICE} && sudo chgrp {{group}} "
                   f"/dev/spidev* && {RESTART}")),
    _wrong("installed file", _shipped,
           failure(lambda r: r.masked, f"{SERVICE} is masked, or its unit is empty: it cannot start",
                   f"sudo systemctl unmask {SERVICE} && sudo install -m 644 {{source}} {{place}} && {{after}}"),
           failure(lambda r: r.differs, "{place} {how} (changes belong into a drop-in: systemctl edit)",
                   "stop the robot, then: sudo install -D -m 644 {source} {place} && {after}")),
    _wrong("systemd unit", _reload, failure(lambda r: r.reload == "yes",
           f"{SERVICE} was edited, and systemd still goes by what was there before",
           f"stop the robot, then: sudo systemctl daemon-reload && sudo systemctl restart {SERVICE}")),
    # A drop-in is named once, by what is worst of it.
    _wrong("drop-in", _drop_ins,
           warning(lambda r: r.simulates, "{path} makes the controller a simulated one: the service moves no robot, "
                   "and stops none after its end", f"before the robot is to move: {_ASIDE}"),
           failure(lambda r: r.emptied, "{path} empties ExecStopPost=: nothing stops the servos if the gateway dies",
                   f"stop the robot, then put it aside: {_ASIDE}"),
           warning(lambda r: "HEXAPOD_" in r.environment,
                   "{path} has settings, which hold in place of gateway.toml: {environment}",
                   f"write them there, and stop the robot, then put it aside: {_ASIDE}"),
           warning(lambda r: r.depends, "{path} changes what Stops depend on: {depends}",
                   f"if nobody knows why, stop the robot, then put it aside: {_ASIDE}")),
    _wrong("state", _state,
           failure(lambda r: not r.is_folder, f"{STATE_FOLDER} is no folder: {_CANNOT_START}",
                   f"sudo mv {STATE_FOLDER} {STATE_FOLDER}.old && {RESTART}"),
           failure(lambda r: r.read_only,
                   f"{STATE_FOLDER} is on a file system that is read-only: no calibration or list is kept",
                   "see why (dmesg), then: sudo mount -o remount,rw {mount}"),
           failure(lambda r: not r.own, f"{STATE_FOLDER} is not the service's to write: it may not start, nor stop the "
                   "servos after its end", _OWN_STATE),
           failure(lambda r: r.free_mb < _LEAST_FREE_MB,
                   f"{STATE_FOLDER} has {{free_mb}} MB free on its disk: no calibration or list is kept",
                   "find what fills it (sudo du -xh {mount} | sort -h | tail); the journal's part goes by: "
                   "sudo journalctl --vacuum-size=50M"),
           failure(lambda r: r.inodes < _LEAST_INODES, f"{STATE_FOLDER} has {{inodes}} files left on its disk: no "
                   "calibration or list is kept", "find the folder with most files, and empty it: "
                   "sudo du -x --inodes {mount} | sort -n | tail"),
           warning(lambda r: r.forgets, f"{STATE_FOLDER} is on {{kind}}, which a boot empties: calibration, "
                   "revocations and the emergency stop are lost then",
                   "keep the folder on a partition of its own (docs/troubles.md)")),
    _wrong("state", _some(_foreign), failure(always,
           f"in {STATE_FOLDER}, not the service's to read and write: {{some}}", _OWN_STATE)),
    _wrong("private key", _some(_exposed), warning(always,
           "others than root and the service may read {some}", "make a new one if others use this machine; else: "
           f"sudo chown root:{SERVICE} {{all}} && sudo chmod 640 {{all}}")),
    _wrong("private key", _some(_authority_keys), warning(always,
           "{some} is the authority's key: who takes this robot's card can make certificates for all its robots",
           "see that it is on another machine, then: sudo shred -u {all}")),
)
# fmt: on
