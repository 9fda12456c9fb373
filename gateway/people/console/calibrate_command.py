"""`hexapod-gateway calibrate`: one call of commands/calibration.py each; without a command, the console's guide."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gateway.people.commands.options import ConnectOption, JsonOption, TimeoutOption, ZenohConfigOption

if TYPE_CHECKING:
    from gateway.people.commands.reach import Connection

app = typer.Typer(
    invoke_without_command=True,
    help="Set each servo's trim, direction and limits, and the landing pose.\n\n"
    "Without a command it opens the guide in the console: choose a servo, start it alone, move it, enter what you see "
    "on the robot, and write that. If your console runs already, it prints a link. Otherwise (or with --connect or "
    "--zenoh-config) it starts a console and opens the browser. The commands below are for scripts.",
)
LegOption = Annotated[
    list[int] | None, typer.Option("--leg", metavar="N", min=1, max=6, help="Only this leg; may be repeated.")
]
YesOption = Annotated[bool, typer.Option("--yes", help="Do not ask first.")]


def _reach(connect: str | None, zenoh_config: Path | None, timeout_s: float) -> "Connection":
    from gateway.people.commands.reach import connection

    return connection(connect, zenoh_config, timeout_s, source="hexapod-gateway calibrate")


@app.callback()
def guide(
    context: typer.Context,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    if context.invoked_subcommand is None:
        from gateway.people.console import command

        sys.exit(command.calibration(connect, zenoh_config, timeout))


@app.command()
def show(
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Print the calibration in force, all 18 servos."""
    from gateway.people.commands import calibration

    print_it = calibration.export if as_json else calibration.show
    sys.exit(print_it(_reach(connect, zenoh_config, timeout)))


@app.command("set")
def set_servo(
    servo: Annotated[int, typer.Argument(metavar="SERVO", help="The leg and the joint, such as 32.")],
    trim: Annotated[
        float | None, typer.Option("--trim", metavar="DEG", help="Added to each angle on the wire, -90 to 90.")
    ] = None,
    inverted: Annotated[
        bool | None, typer.Option("--inverted/--as-drawn", help="The direction in which it turns.", show_default=False)
    ] = None,
    lowest: Annotated[float | None, typer.Option("--min", metavar="DEG", help="Its lowest angle in commands.")] = None,
    highest: Annotated[
        float | None, typer.Option("--max", metavar="DEG", help="Its highest angle in commands.")
    ] = None,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Change the given values of one servo. The servo must not run."""
    from gateway.people.commands import calibration

    wanted = {"trim_deg": trim, "inverted": inverted, "min_deg": lowest, "max_deg": highest}
    sys.exit(calibration.set_servo(_reach(connect, zenoh_config, timeout), servo, wanted))


@app.command()
def export(connect: ConnectOption = None, zenoh_config: ZenohConfigOption = None, timeout: TimeoutOption = 2.0) -> None:
    """Print the whole calibration as JSON, for `import` and for programs."""
    from gateway.people.commands import calibration

    sys.exit(calibration.export(_reach(connect, zenoh_config, timeout)))


@app.command("import")
def import_file(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A file that `export` printed; - for stdin.")],
    yes: YesOption = False,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Replace the whole calibration with a file. Servos that the file does not name become as drawn."""
    from gateway.people.commands import calibration

    sys.exit(calibration.import_file(_reach(connect, zenoh_config, timeout), file, agreed=yes))


@app.command()
def landing(
    leg: LegOption = None,
    yes: YesOption = False,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Record the landing pose: the angles of the servos that run now."""
    from gateway.people.commands import calibration

    sys.exit(calibration.landing(_reach(connect, zenoh_config, timeout), leg or [], agreed=yes))


@app.command("accept-default")
def accept_default(
    yes: YesOption = False,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Replace a broken or foreign calibration file with the default: all servos as drawn."""
    from gateway.people.commands import calibration

    sys.exit(calibration.accept_default(_reach(connect, zenoh_config, timeout), agreed=yes))
