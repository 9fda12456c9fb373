"""`check` as root looks with the service's rights: its user, its groups, its limits. What root can do shows nothing."""

import grp
import os
import pwd
import resource
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import Final

from gateway.errors import GatewayError
from gateway.onboard.check.table import SERVICE

_GROUPS_OF_THE_UNIT: Final = ("spi", "dialout")
_LOADED_LATE: Final = ("gateway.certs.folder", "serial", "spidev")
"""The service's user may not be able to read the folder that this Python runs from."""
_CRASHED: Final = 70  # EX_SOFTWARE


def uid() -> int | None:
    """The service's user, where it is installed."""
    try:
        return pwd.getpwnam(SERVICE).pw_uid
    except KeyError:
        return None


def run(look: Callable[[], int], rtprio: int | None) -> int:
    """Call `look` as the service's user where that is possible, else as oneself. Return what it returned.

    `rtprio` is the limit that the unit sets.
    """
    if os.geteuid() or uid() is None:
        return look()
    for module in _LOADED_LATE:
        with suppress(ImportError):
            import_module(module)
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    code = _CRASHED
    try:
        with suppress(PermissionError):  # without CAP_SETUID or CAP_SETGID: the line of the user reports it
            _become(pwd.getpwnam(SERVICE), rtprio)
        code = look()
    except GatewayError as error:
        sys.stderr.writelines(f"hexapod-gateway: {line}\n" for line in str(error).splitlines())
        code = error.exit_code
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _become(user: pwd.struct_passwd, rtprio: int | None) -> None:
    if rtprio is not None:
        with suppress(OSError, ValueError):  # without CAP_SYS_RESOURCE, as in a container: `real-time` reports it
            resource.setrlimit(resource.RLIMIT_RTPRIO, (rtprio, rtprio))
    groups = set(os.getgrouplist(user.pw_name, user.pw_gid))
    for group in _GROUPS_OF_THE_UNIT:
        with suppress(KeyError):
            groups.add(grp.getgrnam(group).gr_gid)
    os.setgroups(sorted(groups))
    os.setgid(user.pw_gid)
    os.setuid(user.pw_uid)
