"""The command line of `calibrate`."""

import sys
from typing import Annotated

import typer

from gateway.errors import ConfigError
from gateway.people.tools.options import ConnectOption, TimeoutOption, ZenohConfigOption

app = typer.Typer()


@app.command()
def calibrate(
    show: Annotated[bool, typer.Option("--show", help="Print the calibration in force, all 18 servos.")] = False,
    landing: Annotated[
        bool, typer.Option("--landing", help="Record the landing pose: the angles of the servos that run now.")
    ] = False,
    leg: Annotated[
        list[int] | None,
        typer.Option("--leg", metavar="N", min=1, max=6, help="With --landing: only this leg; may be repeated."),
    ] = None,
    accept_default: Annotated[
        bool,
        typer.Option(
            "--accept-default",
            help="Where the robot's calibration file is broken or foreign: go on with the default, servos as drawn.",
        ),
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="With --landing and --accept-default: without asking first.")
    ] = False,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Guide one person beside the robot through trim, direction and limits of each servo.

    Choose a servo (32 is joint 2 of leg 3). It is started alone, at an angle that you see first, and goes there at
    once, wherever it stands: keep hands away. Move it with the arrow keys, and say what you see on the robot: at which
    angle it now stands (trim), that it goes the wrong way (direction), how far it may go (limits). Space stops it.

    Nothing is written before you say so (w, then y). Leaving in any way stops the leg: q, Ctrl-C, a closed terminal, a
    lost link. The guide drives (see `lease`) until it ends.

    Exit codes: 0 done, 1 rejected, no terminal, or a Stop that nobody confirmed, 4 no gateway answers.
    """
    if show + landing + accept_default > 1:
        raise ConfigError("--show, --landing and --accept-default are three things: one at a time")
    if leg and not landing:
        raise ConfigError("--leg goes with --landing; the guide asks for a servo")
    from gateway.people.tools import reach
    from gateway.people.tools.calibrate import once

    connection = reach.connection(connect, zenoh_config, timeout, source="hexapod-gateway calibrate")
    if show:
        sys.exit(once.show(connection))
    if landing:
        sys.exit(once.landing(connection, leg or [], agreed=yes))
    if accept_default:
        sys.exit(once.accept_default(connection, agreed=yes))
    from gateway.people.tools.calibrate.screen import run

    sys.exit(run(connection))
