"""Certificates: access to the gateway by role. `folder.init` once, `folder.issue` for each laptop."""

import datetime as dt
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from gateway.certs import authority, files, folder, proof, revocation

OPERATOR: Final = "operator"
OBSERVER: Final = "observer"
BUTTON: Final = "button"
"""A stop button: may stop the robot, but not move it."""
LAPTOP_ROLES: Final = (OPERATOR, OBSERVER, BUTTON)
CA_DAYS: Final = 3650
LEAF_DAYS: Final = 730
CONSOLE_DAYS: Final = 459
"""Apple's browsers accept a server's certificate for at most 825 days; ours begin 365 days in the past."""
WARN_DAYS: Final = 60
"""Warn this long before a certificate expires: enough to find the person with the CA's key."""

__all__ = ["authority", "files", "folder", "proof", "revocation"]


def __getattr__(name: str) -> ModuleType:
    # Imported at first use: cryptography loads slowly, which must not delay an emergency stop.
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return import_module(f"{__name__}.{name}")


def expires_soon(name: str, end: dt.datetime, now: dt.datetime) -> str | None:
    """Return `gateway.pem expires on 2028-11-22, in 59 days`; None while WARN_DAYS or more are left."""
    left_days = (end - now) // dt.timedelta(days=1)
    if end <= now:
        return f"{name} expired on {end:%Y-%m-%d}"
    soon = f"{name} expires on {end:%Y-%m-%d}, in {left_days} day{'' if left_days == 1 else 's'}"
    return soon if left_days < WARN_DAYS else None


def how_to_renew(file: str, role: str, name: str) -> str:
    """Return how to renew the certificate in `file`; `role` and `name` as `folder.describe` returns them."""
    if role == "ca":
        return "hexapod-gateway certs init --host ROBOT --dir DIR in another folder, and issue all certificates again"
    return f"{renewal(role if role == 'gateway' else name)}, and copy {file} here"


def renewal(holder: str) -> str:
    """Return the command that renews a certificate. A person fills in DIR."""
    return f"where ca.key is: hexapod-gateway certs renew {holder} --dir DIR"


def first_fault(*faults: tuple[object, str]) -> str:
    """Return the sentence of the first fault that applies; "": none does."""
    return next((sentence for applies, sentence in faults if applies), "")
