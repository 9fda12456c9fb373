"""The command line of the black box: `incidents list`, `show`, `export`, `replay`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gateway.people.commands.options import ConfigOption, JsonOption

if TYPE_CHECKING:
    from gateway.robot.settings import Settings

app = typer.Typer(
    help="List and explain the stops and faults that the black box recorded.\n\n"
    "The black box survives a crash of the gateway. A power cut or a reboot erases it. Use sudo to read the service's.",
    invoke_without_command=True,
)

IncidentArgument = Annotated[
    str,
    typer.Argument(metavar="ID", help="An id from `list` or from an event, or `last` for the newest."),
]


@app.callback()
def _list_without_command(context: typer.Context, config: ConfigOption = None) -> None:
    if context.invoked_subcommand is None:
        list_incidents(context, config)
    context.obj = config  # `incidents --config F show last`


def _settings(context: typer.Context, config: Path | None) -> "Settings":
    from gateway.robot import settings

    # Reading needs no framing, so none is required, as with a simulated controller.
    return settings.load(config or context.obj, simulated=True)


@app.command("list")
def list_incidents(context: typer.Context, config: ConfigOption = None, as_json: JsonOption = False) -> None:
    """List the incidents, newest first."""
    from gateway.onboard import black_box

    black_box.list_all(_settings(context, config), as_json=as_json)


@app.command()
def show(
    context: typer.Context, incident: IncidentArgument, config: ConfigOption = None, as_json: JsonOption = False
) -> None:
    """Explain what happened: commands, decisions and frames, with times relative to the stop."""
    from gateway.onboard import black_box

    black_box.show(_settings(context, config), incident, as_json=as_json)


@app.command()
def export(
    context: typer.Context,
    incident: IncidentArgument,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The MCAP file to write, such as stop.mcap")],
    config: ConfigOption = None,
) -> None:
    """Write an incident as an MCAP file, for Foxglove, Lichtblick, Rerun or your own program."""
    from gateway.onboard import black_box

    black_box.export(_settings(context, config), incident, file)


@app.command()
def replay(
    context: typer.Context,
    incident: IncidentArgument,
    config: ConfigOption = None,
    until: Annotated[
        str | None, typer.Option(metavar="TIME", help="End at this time, in seconds after the incident: 0.25 or -1.5.")
    ] = None,
    settings: Annotated[
        list[str], typer.Option("--set", metavar="NAME=VALUE", help="Decide with another setting. Repeatable.")
    ] = [],  # noqa: B006  (typer's way)
    as_test: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a test that decides the same, to this new file.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Decide an incident again: which rule led to which frames. Ends with 1 if other frames were written."""
    from gateway.onboard import black_box

    found = _settings(context, config)
    if not black_box.replay(found, incident, until=until, changes=settings, file=as_test, as_json=as_json):
        raise typer.Exit(1)
