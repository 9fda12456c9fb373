"""The arguments of `console`, which its command takes and its server reads."""

from dataclasses import dataclass
from pathlib import Path

from gateway.people.commands.options import Reach
from gateway.people.console.pages.page_messages import Role


@dataclass(frozen=True)
class Options:
    """The command's arguments, as `hexapod-gateway console --help` explains them."""

    reach: Reach
    listen: str | None = None
    cert: Path | None = None
    key: Path | None = None
    role: Role = "operator"
    geometry: Path | None = None
    adapt: bool = False
    open_browser: bool = False
    phone: bool = False
    card: str = ""
    """The card of the page to which the first link leads; empty: the page's start."""
