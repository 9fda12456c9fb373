"""The command line of the black box: `incidents list`, `show`, `export`."""

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
