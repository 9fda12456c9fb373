"""Commands in messages: named as this process was called, with the options that reach its gateway."""

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
_options: Final[dict[str, str | Path | None]] = {}


def plain(endpoints: Sequence[str]) -> str | None:
    """Return the endpoint, of those a gateway listens on, that needs no certificate; None: there is none."""
    found = [endpoint for endpoint in endpoints if not endpoint.startswith(("tls/", "quic/"))]
    return DEFAULT_ENDPOINT if DEFAULT_ENDPOINT in found else next(iter(found), None)


def reach_by(**options: str | Path | None) -> None:
    """Add the options `connect` and `zenoh_config` to the commands of later messages; None removes an option."""
    _options.update(options)


def this_command() -> str:
    """Return the name by which this program was called, for commands to copy: `.venv/bin/…` after `make run`."""
    called, found = sys.argv[0], shutil.which("hexapod-gateway")
    here = Path(called).name == "hexapod-gateway" and (
        found is None or Path(called).absolute() != Path(found).absolute()
    )
    return called if here else "hexapod-gateway"


def command(arguments: str, **given: str | Path | None) -> str:
    """Return a command that reaches this process's gateway: `hexapod-gateway reset --connect tcp/192.0.2.7:7447`.

    `given` replaces the options of `reach_by`, for another gateway than the command line's.
    """
    default = {} if CONNECT_VARIABLE in os.environ else {"connect": DEFAULT_ENDPOINT}
    known = {name: value for name, value in _options.items() if value != default.get(name)}
    options = ((name.replace("_", "-"), value) for name, value in (given or known).items() if value is not None)
    return " ".join((this_command(), arguments, *(f"--{name} {shlex.quote(str(value))}" for name, value in options)))


def install(extra: str) -> str:
    """Return the command that installs an optional part, such as "record", for the Python that runs this."""
    python = shlex.quote(sys.executable)
    return f"{python} -m pip install 'hexapod-gateway[{extra}]'"
