"""Options that several commands have."""

from pathlib import Path
from typing import Annotated

import typer

ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="PATH",
        readable=False,  # what cannot be read is reported with a remedy
        help="Settings (TOML). Default: /etc/hexapod-gateway/gateway.toml, if it exists.",
    ),
]
ConnectOption = Annotated[
    str | None,
    typer.Option(
        "--connect",
        metavar="ENDPOINT",
        help="Where the gateway listens. Default: tcp/127.0.0.1:7447, or what the --zenoh-config file says.",
    ),
]
ZenohConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--zenoh-config",
        metavar="PATH",
        help="A Zenoh configuration (JSON5) with certificates, such as the NAME.json5 that `certs issue` makes.",
    ),
]
OtherShapeOption = Annotated[
    Path | None,
    typer.Option("--geometry", metavar="FILE", help="Another robot's shape (JSON). Default: the Elkapod's."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="For programs.")]
TimeoutOption = Annotated[
    float, typer.Option("--timeout", metavar="S", min=0.05, help="Give up after this many seconds.")
]
