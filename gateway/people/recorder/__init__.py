"""`record`: what a gateway publishes, as a file, live, or as a table.

Here is the command line alone.
"""

import sys
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from gateway.errors import ConfigError
from gateway.people.commands.options import OtherShapeOption, Reach, reaches

app = typer.Typer()


class RecordOptions(NamedTuple):
    """What `record` records, and where to."""

    file: Annotated[
        Path | None, typer.Argument(metavar="[FILE]", show_default=False, help="The file to write, such as ride.mcap")
    ] = None
    live: Annotated[
        bool,
        typer.Option("--live", help="Show it live in Foxglove or Lichtblick on this machine; FILE is optional then."),
    ] = False
    csv: Annotated[
        bool,
        typer.Option("--csv", help="Also write all commanded angles as a table: FILE with .csv."),
    ] = False
    port: Annotated[
        int, typer.Option(metavar="N", min=0, max=65535, help="The port of --live on 127.0.0.1; 0: any free port.")
    ] = 8765
    seconds: Annotated[
        float | None,
        typer.Option("--for", metavar="S", min=0, help="End after this many seconds."),
    ] = None
    camera: Annotated[
        list[str] | None,
        typer.Option(metavar="[NAME=]URL", help="Also record a camera's MJPEG stream. Repeatable."),
    ] = None
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that exists.")] = False
    geometry: OtherShapeOption = None


@app.command("record")
@reaches
def command(options: RecordOptions, reach: Reach) -> None:
    """Record what the gateway publishes into an MCAP file, or show it live, until Ctrl-C. It sends no commands.

    Foxglove, Lichtblick, Rerun and ROS 2's tools open the file (docs/recordings.md). It contains frames if the gateway
    publishes them (telemetry.frames).
    """
    file = options.file
    if file is None and (options.csv or not options.live):
        raise ConfigError("name the file to make, such as ride.mcap, or show the robot in a viewer with --live")
    if file is not None and file.suffix != ".mcap":
        raise ConfigError(f"{file}: name the file with .mcap, by which viewers know it: {file.with_suffix('.mcap')}")
    from gateway.people.recorder.record import record

    sys.exit(record(reach.connection("hexapod-gateway record"), options))
