"""`check` as root looks with the service's rights: its user, its groups, its limits. What root can do shows nothing."""

import grp
import os
import pwd
import resource
import sys
from contextlib import suppress
from importlib import import_module
from typing import Final

from gateway.onboard.check.table import SERVICE

_GROUPS_OF_THE_UNIT: Final = ("spi", "dialout")
_LOADED_LATE: Final = ("gateway.certs.folder", "serial", "spidev")
"""The service's user may not be able to read the folder that this Python runs from."""


def uid() -> int | None:
    """The service's user, where it is installed."""
    with suppress(KeyError):
        return pwd.getpwnam(SERVICE).pw_uid
    return None


def go_on_as(rtprio: str) -> None:
    """As root, go on in a child that is the service's user, where there is one; this process ends as the child does.

    `rtprio` is the limit that the unit sets, "" if there is none.
    """
    if os.geteuid() or uid() is None:
        return
    for module in _LOADED_LATE:
        with suppress(ImportError):
            import_module(module)
    sys.stdout.flush()
    if child := os.fork():
        sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    user = pwd.getpwnam(SERVICE)
    groups = {each.gr_gid for each in grp.getgrall() if each.gr_name in _GROUPS_OF_THE_UNIT}
    with suppress(OSError, ValueError):  # without CAP_SYS_RESOURCE, as in a container: `real-time` reports it
        resource.setrlimit(resource.RLIMIT_RTPRIO, (int(rtprio), int(rtprio)))
    with suppress(PermissionError):  # without CAP_SETUID or CAP_SETGID: the line of the user reports it
        os.setgroups(sorted(groups | set(os.getgrouplist(user.pw_name, user.pw_gid))))
        os.setgid(user.pw_gid)
        os.setuid(user.pw_uid)
