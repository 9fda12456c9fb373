"""`walk`: a person at the keyboard drives, or a script gives the velocity.

Here is its command line alone: an emergency stop from a shell loads no more.
"""

import sys
from typing import Annotated

import typer

from gateway.errors import ConfigError
from gateway.people.commands.options import (
    AdaptOption,
    ConnectOption,
    OtherShapeOption,
    TimeoutOption,
    ZenohConfigOption,
)

app = typer.Typer()


def _gaits() -> list[str]:
    from gateway.people.walking import GAITS

    return list(GAITS)


@app.command()
def walk(
    forward: Annotated[
        float, typer.Option("--forward", metavar="M_S", help="Metres a second; below 0: backward.")
    ] = 0.0,
    left: Annotated[float, typer.Option("--left", metavar="M_S", help="Metres a second sideways.")] = 0.0,
    turn: Annotated[float, typer.Option("--turn", metavar="RAD_S", help="Counter-clockwise, radians a second.")] = 0.0,
    seconds: Annotated[
        float | None, typer.Option("--seconds", metavar="S", min=0, max=3600, help="Walk this long, without a person.")
    ] = None,
    gait: Annotated[
        str,
        typer.Option(
            "--gait",
            autocompletion=_gaits,
            help="In which order the legs step: tripod (the fastest), ripple or wave.",
        ),
    ] = "tripod",
    height: Annotated[float | None, typer.Option("--height", metavar="M", help="Of the body above the ground.")] = None,
    adapt: AdaptOption = False,
    geometry: OtherShapeOption = None,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Make the robot walk: from the keyboard, or with --seconds without a person.

    W S and the arrows walk and turn while you hold them, A D step sideways, space or e is the emergency stop; the
    screen shows the other keys. It holds the lease meanwhile. Lay the robot on its belly first: its legs
    go to their first pose as fast as they can, one after the other.

    A terminal does not report that a key is released. So a key counts for 0.7 s when it is pressed, which bridges the
    pause before the terminal repeats it, and for 0.2 s after each repetition. Then the robot finishes its step.

    `hexapod-gateway walk --forward 0.1 --seconds 5` stands up, walks, sits down and stops. Ctrl-C (or SIGTERM) has it
    finish its step and sit down before it stops; Ctrl-C again stops it at once, as Ctrl-C does at the keyboard.
    """
    from gateway.people.commands import reach

    terrain = "adapt" if adapt else "level"
    connection = reach.connection(connect, zenoh_config, timeout, source="hexapod-gateway walk")
    if seconds is not None:
        from gateway.people.commands.walk import script

        sys.exit(script.walk(connection, gait, geometry, terrain, (forward, left, turn), seconds, height))
    if forward or left or turn:
        raise ConfigError("--forward, --left and --turn go with --seconds; without it you drive from the keyboard")
    from gateway.people.commands.walk import screen

    sys.exit(screen.drive(connection, gait, geometry, terrain, height))
