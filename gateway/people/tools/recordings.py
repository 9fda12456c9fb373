"""The command line of recordings and viewers: `record`, `replay` and `foxglove`."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from gateway.errors import ConfigError
from gateway.people.terminal import say
from gateway.people.tools.options import (
    ConnectOption,
    JsonOption,
    OtherShapeOption,
    TimeoutOption,
    ZenohConfigOption,
)

app = typer.Typer()


@app.command()
def record(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The file to make, such as ride.mcap")],
    seconds: Annotated[
        float | None, typer.Option("--for", metavar="S", min=0, help="End by itself after this many seconds.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that exists.")] = False,
    geometry: OtherShapeOption = None,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Record state, events and frames into an MCAP file, until Ctrl-C.

    Foxglove and Lichtblick open it, and so do twenty lines of Python (docs/recordings.md). Frames are in it where the
    gateway publishes them (telemetry.frames).
    """
    from gateway.people.tools import reach
    from gateway.people.tools.record import record

    if file.suffix != ".mcap":
        raise ConfigError(f"{file}: name the file with .mcap, by which viewers know it: {file.with_suffix('.mcap')}")
    connection = reach.connection(connect, zenoh_config, timeout, source="hexapod-gateway record")
    sys.exit(record(connection, file, geometry=geometry, overwrite=force, seconds=seconds))


files = typer.Typer(help="Show a recording's contents, and cut pieces of it.", no_args_is_help=True)
app.add_typer(files, name="recordings")


@files.command()
def info(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording, or an incident that was exported")],
    as_json: JsonOption = False,
) -> None:
    """Show when it was recorded, with which versions and settings, and how many messages it has of what."""
    from gateway.people.recordings.contents import contents

    found = contents(file)
    if as_json:
        typer.echo(json.dumps(found.as_json(), indent=1))
        return
    for line in found.lines():
        say(line)


@files.command()
def cut(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording")],
    into: Annotated[Path, typer.Argument(metavar="INTO", help="The file to make")],
    from_s: Annotated[float, typer.Option("--from", metavar="S", min=0, help="Seconds after its first message.")] = 0.0,
    to_s: Annotated[float, typer.Option("--to", metavar="S", min=0, help="The same.")] = 1e9,
) -> None:
    """Make a file of a piece of it; the robot's description and the calibration come along.

    Without --from and --to: a whole file of all that can be read of one that was cut off, or is damaged.
    """
    from gateway.people.recordings.contents import cut

    count = cut(file, into, from_s=from_s, to_s=to_s)
    say(f"{into}: {count} messages")


@app.command()
def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording with frames")],
    speed: Annotated[float, typer.Option("--speed", metavar="X", min=0.1, max=10, help="2 is twice as fast.")] = 1.0,
    yes: Annotated[bool, typer.Option("--yes", help="Move a real robot without asking.")] = False,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Drive a gateway with the frames of a recording, in their time; asks before it moves a real robot.

    It holds the lease meanwhile, and stops all legs at the end, also on Ctrl-C.
    """
    from gateway.people.tools import reach
    from gateway.people.tools.replay import REPLAY_SOURCE, replay

    connection = reach.connection(connect, zenoh_config, timeout, source=REPLAY_SOURCE)
    sys.exit(replay(connection, file, speed=speed, agreed=yes))


@app.command()
def foxglove(
    port: Annotated[
        int, typer.Option("--port", metavar="N", min=0, max=65535, help="On 127.0.0.1; 0: any free one.")
    ] = 8765,
    origin: Annotated[
        list[str] | None,
        typer.Option(
            "--origin", metavar="ORIGIN", help="Also let pages of this origin look (https://HOST); repeatable."
        ),
    ] = None,
    geometry: OtherShapeOption = None,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Show the robot live in Foxglove or Lichtblick, with the channels of a recording. Read only."""
    from gateway.people.tools import reach
    from gateway.people.tools.foxglove_server import serve

    connection = reach.connection(connect, zenoh_config, timeout, source="hexapod-gateway foxglove")
    sys.exit(serve(connection, port=port, geometry=geometry, origins=origin or ()))
