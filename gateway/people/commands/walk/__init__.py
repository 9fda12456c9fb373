"""`walk`: a person at the keyboard drives, or a script gives the velocity.

Here is its command line alone: an emergency stop from a shell loads no more.
"""

import sys
from typing import Annotated

import typer

from gateway.errors import ConfigError
from gateway.people.commands.options import AdaptOption, OtherShapeOption, Reach, reaches

app = typer.Typer()


def _gaits() -> list[str]:
    from gateway.people.walking.gaits import GAITS

    return list(GAITS)


@app.command()
@reaches
def walk(
    *,
    forward: Annotated[
        float, typer.Option(metavar="M_S", help="Speed forward, in metres a second; below 0: backward.")
    ] = 0.0,
    left: Annotated[
        float, typer.Option(metavar="M_S", help="Speed to the left, in metres a second; below 0: to the right.")
    ] = 0.0,
    turn: Annotated[
        float,
        typer.Option(metavar="RAD_S", help="Speed of turning to the left, in radians a second; below 0: to the right."),
    ] = 0.0,
    seconds: Annotated[
        float | None, typer.Option(metavar="S", min=0, max=3600, help="Walk this long, without a person.")
    ] = None,
    gait: Annotated[
        str,
        typer.Option(autocompletion=_gaits, help="The order in which legs step: tripod (the fastest), ripple or wave."),
    ] = "tripod",
    height: Annotated[
        float | None, typer.Option(metavar="M", help="Height of the body above the ground, in metres.")
    ] = None,
    adapt: AdaptOption = False,
    geometry: OtherShapeOption = None,
    reach: Reach,
) -> None:
    """Make the robot walk: from the keyboard, or with --seconds without a person.

    Hold W, S or an arrow to walk and turn, A or D to step sideways. Space or Escape is the emergency stop. The
    screen shows the other keys. Lay the robot on its belly first: one after the other, its legs go to their first pose
    as fast as they can. The command holds the lease, so nobody else drives.

    A terminal does not report that a key is released. A key counts for 0.7 s after you press it, until the terminal
    repeats it, and for 0.2 s after each repetition. Then the robot finishes its step.

    `hexapod-gateway walk --forward 0.1 --seconds 5` stands up, walks, sits down and stops. Ctrl-C (or SIGTERM) makes
    the robot finish its step and sit down; a second Ctrl-C stops it at once. At the keyboard the
    first one stops it at once.
    """
    terrain, connection = "adapt" if adapt else "level", reach.connection("hexapod-gateway walk")
    if seconds is not None:
        from gateway.people.commands.walk import script

        sys.exit(script.walk(connection, gait, geometry, terrain, (forward, left, turn), seconds, height))
    if forward or left or turn:
        raise ConfigError("--forward, --left and --turn go with --seconds; without it you drive from the keyboard")
    from gateway.people.commands.walk import screen

    sys.exit(screen.drive(connection, gait, geometry, terrain, height))
