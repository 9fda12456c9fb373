"""The service's directories, which systemd creates, and whether a boot empties one.

Imports little, since `stop-servos` uses it.
"""

import os
from pathlib import Path
from typing import Final

CONFIGURATION: Final = Path("/etc/hexapod-gateway/gateway.toml")
SERVICE_STATE: Final = Path("/var/lib/hexapod-gateway")
"""The service's state directory (deploy/systemd), for commands that systemd did not start."""
SERVICE_RUNTIME: Final = Path("/run/hexapod-gateway")
"""The service's runtime directory, for such commands."""
CONSOLE_STATE: Final = Path("/var/lib/hexapod-console")
"""The state directory of the service hexapod-console."""
FORGETS: Final = frozenset({"overlay", "tmpfs", "ramfs"})
"""File systems that are empty, or as before, after a boot."""
_MOUNTS: Final = Path("/proc/self/mountinfo")


def state_directory(path: str) -> Path | None:
    """Return the folder for state that outlasts the gateway: `path` (`state.path`), else the one that systemd made.

    None: `path` is empty, and systemd did not start this process or made no such folder.
    """
    return Path(path) if path else _named("STATE_DIRECTORY")


def state_to_read(path: str) -> Path | None:
    """Return the state folder for a reader: `state_directory`, else the service's folder if it exists, else None."""
    return state_directory(path) or (SERVICE_STATE if SERVICE_STATE.is_dir() else None)


def runtime_directory() -> Path | None:
    """Return the runtime directory that systemd made, or None. It is in memory, and a reboot empties it."""
    return _named("RUNTIME_DIRECTORY")


def users_state() -> Path:
    """Return the folder for this user's state, outside a service."""
    state_home = os.environ.get("XDG_STATE_HOME")
    return (Path(state_home) if state_home else Path.home() / ".local" / "state") / "hexapod-gateway"


def console_state() -> Path:
    """Return the state folder of this user's console; of the service's in the service, and for root's commands."""
    is_roots = hasattr(os, "geteuid") and os.geteuid() == 0 and CONSOLE_STATE.is_dir()
    return state_directory("") or (CONSOLE_STATE if is_roots else users_state())


def _named(variable: str) -> Path | None:
    value = os.environ.get(variable, "").split(":")[0]
    return Path(value) if value else None


def mount_of(path: Path, mounts: str | None = None) -> tuple[str, str]:
    """Return the mount point and the kind of the file system that holds an absolute `path`.

    `mounts` replaces /proc/self/mountinfo. Paths are compared, since a bind mount has the same device as its parent.
    """
    lines = (line.split() for line in (_MOUNTS.read_text() if mounts is None else mounts).splitlines())
    found = [(words[4].replace("\\040", " "), words[words.index("-") + 1]) for words in lines]
    # Of two at one place, the later one hides the earlier one. The root of a chroot need not be a mount point.
    over = [mount for mount in [("/", "unknown"), *found] if path.is_relative_to(mount[0])]
    return max(reversed(over), key=lambda each: len(each[0]))


def forgets(folder: Path) -> str:
    """Return the kind of the folder's file system if a boot empties it, else "" (also if the kind is unknown)."""
    try:
        kind = mount_of(folder.resolve())[1]
    except (OSError, ValueError):
        return ""
    return kind if kind in FORGETS else ""
