"""Commands of this program in messages: as this process was called, and with the gateway that they need."""

import os
import shlex
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

CONNECT_VARIABLE: Final = "HEXAPOD_CONNECT"
"""The environment variable that is the default of `--connect`."""
DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"
"""Where a gateway listens, and its clients connect, unless somebody names another endpoint."""
_options: Final[dict[str, str]] = {}


def plain(endpoints: Sequence[str]) -> str | None:
    """The endpoint to connect to without a certificate, of those that a gateway listens on; None: there is none."""
    found = [endpoint for endpoint in endpoints if not endpoint.startswith(("tls/", "quic/"))]
    return DEFAULT_ENDPOINT if DEFAULT_ENDPOINT in found else next(iter(found), None)


def reach_by(**options: str | Path | None) -> None:
    """Add `--connect`, `--zenoh-config` (as `connect`, `zenoh_config`) to the commands of later messages; None: not."""
    for name, value in options.items():
        option = _option(name)
        _options.pop(option, None)
        if value is not None:
            _options[option] = shlex.quote(str(value))


def this_command() -> str:
    """The name by which this program was called, to be copied from messages: `.venv/bin/…` after `make run`."""
    called, found = sys.argv[0], shutil.which("hexapod-gateway")
    here = Path(called).name == "hexapod-gateway" and (
        found is None or Path(called).absolute() != Path(found).absolute()
    )
    return called if here else "hexapod-gateway"


def command(arguments: str, **given: str | Path | None) -> str:
    """A command that reaches the gateway of this process: `hexapod-gateway reset --connect tcp/192.0.2.7:7447`.

    `given`: in place of those of `reach_by`, for another gateway than the command line's.
    """
    default = {} if CONNECT_VARIABLE in os.environ else {"--connect": DEFAULT_ENDPOINT}
    options = (f"{option} {value}" for option, value in _options.items() if default.get(option) != value)
    if given:
        options = (f"{_option(name)} {shlex.quote(str(value))}" for name, value in given.items() if value is not None)
    return " ".join((this_command(), arguments, *options))


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"
