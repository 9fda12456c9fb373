"""Options that several commands have."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from gateway import own_command

T = TypeVar("T", str, Path)


def _reach_by(name: str) -> Callable[[T | None], T | None]:
    """A callback that adds the option to commands in messages."""

    def take(value: T | None) -> T | None:
        own_command.reach_by(**{name: value})
        return value

    return take


ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="PATH",
        readable=False,  # an unreadable file is reported later, with a remedy
        help="Settings (TOML). Default: /etc/hexapod-gateway/gateway.toml, if it exists.",
    ),
]
ConnectOption = Annotated[
    str | None,
    typer.Option(
        "--connect",
        metavar="ENDPOINT",
        envvar=own_command.CONNECT_VARIABLE,
        callback=_reach_by("connect"),
        help="Where the gateway listens. Default: tcp/127.0.0.1:7447, or the address in the --zenoh-config file.",
    ),
]
ZenohConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--zenoh-config",
        metavar="PATH",
        callback=_reach_by("zenoh_config"),
        help="A Zenoh configuration (JSON5) with certificates, such as the NAME.json5 that `certs issue` makes.",
    ),
]
OtherShapeOption = Annotated[
    Path | None,
    typer.Option("--geometry", metavar="FILE", help="Another robot's shape (JSON). Default: the Elkapod's."),
]
AdaptOption = Annotated[
    bool,
    typer.Option("--adapt", help="Walk by the robot's sensors: keep the body level, and let feet feel for the ground."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")]
TimeoutOption = Annotated[
    float, typer.Option("--timeout", metavar="S", min=0.05, help="Give up after this many seconds.")
]
