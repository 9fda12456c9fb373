"""Gathers what `installation.py` judges: files, units, folders of an installed service. As root it sees all of it."""

import grp
import os
import pwd
import stat
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from gateway import certs
from gateway.errors import ConfigError
from gateway.onboard import whole
from gateway.onboard.check import service_user
from gateway.onboard.check.installation import ETC, SERVICE, SHIPPED, STATE_FOLDER, UNITS, DropIn, Folder, Installation

_GROUPS: Final = ("spi", SERVICE)
_PROPERTIES: Final = "LoadState,ActiveState,SubState,UnitFileState,NeedDaemonReload,DropInPaths"
_COMMAND: Final = Path("/usr/local/bin", SERVICE)
_MOST_FILES: Final = 20_000
"""Of the state directory: some incidents have hundreds of files each; a look ends in any case."""


def look() -> Installation | None:
    """What there is of an installation; None where no service is installed."""
    if not whole.INSTALLED.is_dir():
        return None
    release = whole.INSTALLED.resolve()
    deploy = next(release.glob("lib/python*/site-packages/gateway/deploy"), release / "deploy")
    units = {unit: _properties(unit) for unit in UNITS}
    own = service_user.uid()
    return Installation(
        release=str(release),
        deploy=str(deploy),
        again=whole.how_to_repeat(release),
        whole=whole.compare(release),
        differ=dict(_differing(deploy)),
        units=units,
        drop_ins=tuple(_drop_ins(units[SERVICE].get("DropInPaths", ""))),
        state=Folder() if own is None else _state(Path(STATE_FOLDER), own),
        user=own is not None,
        groups=tuple(each for each in _GROUPS if not _is_group(each)) if own is not None else (),
        exposed=tuple(_exposed(Path(ETC))),
        authority_keys=tuple(_authority_keys(Path(ETC))),
        command=_command(),
    )


def _differing(deploy: Path) -> Iterator[tuple[str, str]]:
    for each in SHIPPED:
        wanted = _content(deploy / each.source)
        found = _content(Path(each.place))
        if not wanted or found == wanted:  # a damaged release is another line
            continue
        yield each.place, "is missing" if found is None else "is not as this release has it"


def _content(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


def _properties(unit: str) -> dict[str, str]:
    command = ["systemctl", "show", f"{unit}.service", f"--property={_PROPERTIES}"]
    try:
        said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=5).stdout
    except (OSError, subprocess.SubprocessError):
        return {}
    shown = dict(line.split("=", 1) for line in said.splitlines() if "=" in line)
    # systemd does not notice a drop-in in a folder that is new.
    found = (
        path for root in ("/etc", "/run") for path in Path(root, f"systemd/system/{unit}.service.d").glob("*.conf")
    )
    if not {str(path) for path in found} <= set(shown.get("DropInPaths", "").split()):
        shown["NeedDaemonReload"] = "yes"
    return shown


def _drop_ins(paths: str) -> Iterator[DropIn]:
    for path in paths.split():
        with suppress(OSError):
            yield DropIn.of(path, Path(path).read_text(errors="replace"))


def _state(folder: Path, own: int) -> Folder:
    try:
        status = folder.stat()
    except OSError:  # the service's first start makes it
        return Folder()
    if not stat.S_ISDIR(status.st_mode):
        return Folder(is_folder=False)
    read_only = bool(os.statvfs(folder).f_flag & os.ST_RDONLY)
    return Folder(
        owned=status.st_uid == own,
        writable=status.st_mode & stat.S_IRWXU == stat.S_IRWXU,
        foreign=tuple(_foreign(folder, own)),
        read_only_mount=str(_mount_of(folder)) if read_only else "",
    )


def _mount_of(path: Path) -> Path:
    """By the kernel's list: a bind mount is on the same device as what is above it."""
    lines = Path("/proc/self/mountinfo").read_text().splitlines()
    points = (Path(line.split()[4].replace("\\040", " ")) for line in lines)
    return max((each for each in points if path.is_relative_to(each)), key=lambda each: len(each.parts))


def _foreign(folder: Path, own: int) -> Iterator[str]:
    """What another user owns there, or its owner may not read and write. Nothing where one may not look."""
    count = 0
    for parent, folders, files in os.walk(folder):
        for path in (Path(parent, name) for name in (*folders, *files)):
            count += 1
            if count > _MOST_FILES:
                return
            with suppress(OSError):
                status = path.lstat()
                needed = stat.S_IRWXU if stat.S_ISDIR(status.st_mode) else stat.S_IRUSR | stat.S_IWUSR
                if status.st_uid != own or status.st_mode & needed != needed:
                    yield str(path.relative_to(folder))


def _is_group(name: str) -> bool:
    with suppress(KeyError):
        return bool(grp.getgrnam(name))
    return False


def _keys(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*.key") if path.is_file())


def _exposed(folder: Path) -> Iterator[str]:
    """By the file's own rights: a copy or a backup may lie in a folder that is open."""
    yield from (str(key) for key in _keys(folder) if key.stat().st_mode & 0o007 or _owned_by_others(key))


def _owned_by_others(key: Path) -> bool:
    """Another user's, or for a group to read that is neither root's nor the service's."""
    status = key.stat()
    with suppress(KeyError):
        service = pwd.getpwnam(SERVICE)
        groups = {0, service.pw_gid}
        return status.st_uid not in (0, service.pw_uid) or bool(status.st_mode & 0o060 and status.st_gid not in groups)
    return False


def _authority_keys(folder: Path) -> Iterator[str]:
    """Private keys of an authority, by their names as `certs` gives them, or by the certificate next to them."""
    for key in _keys(folder):
        if key.stem == "ca" or key.stem.endswith("-ca") or _is_of(key, key.with_name("ca.pem")):
            yield str(key)


def _is_of(key: Path, certificate: Path) -> bool:
    with suppress(ConfigError):
        public = certs.files.read_key(key).public_key()
        return any(public == each.public_key() for each in certs.files.read_certificates(certificate))
    return False


def _command() -> str:
    """Where the command leads that people type; "" to the release that is installed."""
    wanted = whole.INSTALLED / "bin" / SERVICE
    if not os.path.lexists(_COMMAND):
        return "is missing"
    return "" if _COMMAND.resolve() == wanted.resolve() else f"leads to {_COMMAND.resolve()}"
