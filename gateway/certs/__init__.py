"""Certificates: who may reach the gateway, and as what. `init` once, `issue` for each laptop."""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

OPERATOR: Final = "operator"
OBSERVER: Final = "observer"
BUTTON: Final = "button"
"""May stop the robot and not move it: a stop button."""
LAPTOP_ROLES: Final = (OPERATOR, OBSERVER, BUTTON)
CA_DAYS: Final = 3650
LEAF_DAYS: Final = 730
CONSOLE_DAYS: Final = 459
"""Apple's browsers take a server's certificate of at most 825 days, and ours begin a year in the past."""

if TYPE_CHECKING:
    from gateway.certs import revocation
    from gateway.certs.authority import first_number, is_issued
    from gateway.certs.files import read_certificate, read_certificates, read_file
    from gateway.certs.folder import Certificate, add_robots, console, describe, expiries, init, issue, renew
    from gateway.certs.moving import drop_ca, reissue, replace_ca, revoke, set_pool, states
    from gateway.certs.proof import ProofChecker

_HOMES: Final = {
    **dict.fromkeys(
        ("Certificate", "add_robots", "console", "describe", "expiries", "init", "issue", "renew"),
        "gateway.certs.folder",
    ),
    **dict.fromkeys(("drop_ca", "reissue", "replace_ca", "revoke", "set_pool", "states"), "gateway.certs.moving"),
    **dict.fromkeys(("first_number", "is_issued"), "gateway.certs.authority"),
    "ProofChecker": "gateway.certs.proof",
    **dict.fromkeys(("read_certificate", "read_certificates", "read_file"), "gateway.certs.files"),
}


def __getattr__(name: str) -> Any:
    # Loaded when used: cryptography takes long to load, and no emergency stop should wait for it.
    if name == "revocation":
        return import_module("gateway.certs.revocation")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


__all__ = [
    "BUTTON",
    "CA_DAYS",
    "CONSOLE_DAYS",
    "LAPTOP_ROLES",
    "LEAF_DAYS",
    "OBSERVER",
    "OPERATOR",
    "Certificate",
    "ProofChecker",
    "add_robots",
    "console",
    "describe",
    "drop_ca",
    "expiries",
    "first_number",
    "init",
    "is_issued",
    "issue",
    "read_certificate",
    "read_certificates",
    "read_file",
    "reissue",
    "renew",
    "replace_ca",
    "revocation",
    "revoke",
    "set_pool",
    "states",
]
