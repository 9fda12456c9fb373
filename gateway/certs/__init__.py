"""Certificates: access to the gateway by role. `folder.init` once, `folder.issue` for each laptop."""

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
"""Apple's browsers accept a server's certificate of at most 825 days, and ours begin a year in the past."""

__all__ = ["authority", "files", "folder", "proof", "revocation"]


def __getattr__(name: str) -> ModuleType:
    # Imported at first use: cryptography loads slowly, which must not delay an emergency stop.
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return import_module(f"{__name__}.{name}")
