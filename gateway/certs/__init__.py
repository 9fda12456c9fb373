"""Certificates: who may reach the gateway, and as what. `folder.init` once, `folder.issue` for each laptop."""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from gateway.certs import authority, confirmed, files, folder, moving, proof, revocation

OPERATOR: Final = "operator"
OBSERVER: Final = "observer"
BUTTON: Final = "button"
"""May stop the robot and not move it: a stop button."""
LAPTOP_ROLES: Final = (OPERATOR, OBSERVER, BUTTON)
CA_DAYS: Final = 3650
LEAF_DAYS: Final = 730
CONSOLE_DAYS: Final = 459
"""Apple's browsers take a server's certificate of at most 825 days, and ours begin a year in the past."""

__all__ = ["authority", "confirmed", "files", "folder", "moving", "proof", "revocation"]


def __getattr__(name: str) -> ModuleType:
    # Loaded when used: cryptography takes long to load, and no emergency stop should wait for it.
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return import_module(f"{__name__}.{name}")
