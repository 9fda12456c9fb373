"""The service's directories, as systemd makes and names them. Imports little: `stop-servos` needs it, too."""

import os
from pathlib import Path
from typing import Final

SERVICE_STATE: Final = Path("/var/lib/hexapod-gateway")
"""The service's state directory (deploy/systemd), for commands that systemd did not start."""
SERVICE_RUNTIME: Final = Path("/run/hexapod-gateway")
"""The same for its runtime directory."""


def state_directory() -> Path | None:
    """The folder that systemd has made for what this process keeps; None: systemd did not start it, or made none."""
    return _named("STATE_DIRECTORY")


def runtime_directory() -> Path | None:
    """The same for what a reboot ends: it is in memory."""
    return _named("RUNTIME_DIRECTORY")


def _named(variable: str) -> Path | None:
    given = os.environ.get(variable, "").split(":")[0]
    return Path(given) if given else None
