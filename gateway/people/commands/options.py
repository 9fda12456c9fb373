"""Options that several commands have."""

import inspect
from collections.abc import Callable, Iterator, Mapping
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar

import typer

from gateway.words import own_command

if TYPE_CHECKING:
    from gateway.people.commands.reach import Connection

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


class Reach(NamedTuple):
    """How a command reaches its gateway."""

    connect: ConnectOption = None
    zenoh_config: ZenohConfigOption = None
    timeout: TimeoutOption = 2.0

    def connection(self, source: str) -> "Connection":
        """Return a connection for a `with`, under this name in events; see `reach.connection`."""
        from gateway.people.commands import reach  # loads Zenoh, for which `--help` need not wait

        return reach.connection(*self, source=source)


def reaches(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the fields of each NamedTuple among its parameters, such as `Reach`, as options."""

    @wraps(command)
    def call(**given: Any) -> None:
        command(**_arguments(command, given))

    keyword = inspect.Parameter.KEYWORD_ONLY
    vars(call)["__signature__"] = inspect.Signature([each.replace(kind=keyword) for each in _options(command)])
    return call


def _options(function: Callable[..., Any]) -> Iterator[inspect.Parameter]:
    for each in inspect.signature(function).parameters.values():
        yield from _options(each.annotation) if _has_fields(each) else (each,)


def _arguments(function: Callable[..., Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the function's arguments: options, and NamedTuples of options."""
    return {
        each.name: each.annotation(**_arguments(each.annotation, given)) if _has_fields(each) else given[each.name]
        for each in inspect.signature(function).parameters.values()
    }


def _has_fields(parameter: inspect.Parameter) -> bool:
    return hasattr(parameter.annotation, "_fields")
