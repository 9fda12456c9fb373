"""Which release runs, and with which Python: neither follows a link or the system's upgrade before a restart."""

import os
import re
from pathlib import Path
from typing import Final

from gateway.onboard.check.installation import SERVICE
from gateway.onboard.check.result import Result, warning
from gateway.onboard.whole import INSTALLED

SYSTEM_PYTHON: Final = Path("/usr/bin/python3")
_FOLDER: Final = re.compile(rf"{INSTALLED}-[^/ \n]+")
_AGAIN: Final = "sudo deploy/install.sh"


def running(process: int, *, proc: Path = Path("/proc")) -> Path | None:
    """The folder that a process has loaded the gateway from; None where none runs, or one may not look.

    The kernel's own word, since the command line names the link, which may lead elsewhere by now.
    """
    try:
        found = _FOLDER.search((proc / str(process) / "maps").read_text())
    except OSError:
        return None
    return None if found is None else Path(found.group())


def findings(found: Path | None) -> list[Result]:
    """What a person should know of the two; `found`: the release that runs."""
    return [result for result in (release(found), interpreter()) if result is not None]


def release(found: Path | None, *, installed: Path = INSTALLED) -> Result | None:
    """Whether the release that runs is the one installed; None where that cannot be seen, or is so."""
    if found is None or not installed.exists() or found == installed.resolve():
        return None
    return warning(
        "release",
        f"the service that runs is another release than the one installed: {found}, not {installed.resolve()}",
        f"stop the robot, then: sudo systemctl restart {SERVICE}",
    )


def interpreter(*, installed: Path = INSTALLED, system: Path = SYSTEM_PYTHON) -> Result | None:
    """Whether an upgrade of the system takes the service its Python; None where the service has one that stays."""
    link = installed / "bin" / "python"
    if not link.is_symlink():
        return None
    # The first link that leads out of the folder: `python` is a link to `python3.11` next to it, or to `python3`.
    while link.is_symlink() and link.is_relative_to(installed):
        link = link.parent / os.readlink(link)
    if link == system and system.resolve() != system:
        return warning(
            "Python",
            f"the service runs {system}, whatever that is: an upgrade of the system makes it another, and neither the "
            "service nor its stop-servos starts then",
            f"before the upgrade: {_AGAIN}, which takes {system.resolve()}",
        )
    if system.exists() and link.name != system.resolve().name and link.parent == system.parent:
        return warning(
            "Python",
            f"the system's python3 is another one now, {system.resolve()}; the service still runs {link}, which the "
            "system may remove",
            f"before that: {_AGAIN}, which takes the new one",
        )
    return None
