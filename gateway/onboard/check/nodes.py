"""Device nodes of this machine: whether one is there, is a device, and may be opened."""

import grp
import os
import pwd
import stat
from pathlib import Path

from gateway.onboard.check.result import Result, failure


def missing(name: str, path: Path, setting: str, absent: str) -> Result | None:
    """Why the path is no device; None: it is one. `absent` fixes that nothing is there."""
    try:
        mode = path.stat().st_mode
    except PermissionError as error:
        return failure(name, f"{path} cannot be looked at ({error.strerror})", "check the folder's permissions")
    except OSError:
        return failure(name, f"{path} does not exist", absent)
    return None if stat.S_ISCHR(mode) else failure(name, f"{path} is no device node", f"set {setting} to one")


def group_that_may(path: Path) -> str | None:
    """The group that may read and write it; None where only its owner may, or everybody but that group."""
    status = path.stat()
    return group(status.st_gid) if status.st_gid and (status.st_mode & 0o060) == 0o060 else None


def denied(name: str, path: Path, fix: str) -> Result:
    """That this user may not open it."""
    status = path.stat()
    rights = f"{stat.filemode(status.st_mode)}, group {group(status.st_gid)}"
    return failure(name, f"{path} may not be opened by {user()} ({rights})", fix)


def user() -> str:
    """The user of this process."""
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())


def group(gid: int) -> str:
    """A group's name, or its number."""
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)
