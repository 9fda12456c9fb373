"""The command line of recordings: `record`."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from gateway.errors import ConfigError
from gateway.tools.options import ConnectOption, TimeoutOption, ZenohConfigOption

app = typer.Typer()

GeometryOption = Annotated[
    Path | None,
    typer.Option("--geometry", metavar="FILE", help="The robot's shape (JSON). Default: the Elkapod's."),
]


@app.command()
def record(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The file to make, such as ride.mcap")],
    seconds: Annotated[
        float | None, typer.Option("--for", metavar="S", min=0, help="End by itself after this many seconds.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that exists.")] = False,
    repair: Annotated[
        bool, typer.Option("--repair", help="Record nothing: make a file whole that was cut off.")
    ] = False,
    geometry: GeometryOption = None,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Record state, events and frames into an MCAP file, until Ctrl-C.

    Foxglove and Lichtblick open it, and so do twenty lines of Python (docs/recordings.md). Frames are in it where the
    gateway publishes them (telemetry.frames). Recordings in the same folder that were cut off are made whole first.

    Exit codes: 0 ended on request, 1 the disk does not take it, 2 the file exists or is none, 4 no gateway answers.
    """
    from gateway.tools import reach
    from gateway.tools.record import record, repair_file

    if repair:
        sys.exit(repair_file(file))
    if file.suffix != ".mcap":
        raise ConfigError(f"{file}: name the file with .mcap, by which viewers know it: {file.with_suffix('.mcap')}")
    connection = reach.connection(connect, zenoh_config, timeout, source="hexapod-gateway record")
    sys.exit(record(connection, file, geometry=geometry, overwrite=force, seconds=seconds))
