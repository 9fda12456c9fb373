"""`hexapod-gateway calibrate`: one call of commands/calibration.py each; without a command, the console's guide."""

import sys
from pathlib import Path
from typing import Annotated, Final

import typer

from gateway.people.commands.options import Reach, reaches

_SOURCE: Final = "hexapod-gateway calibrate"
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


@app.callback()
@reaches
def guide(*, context: typer.Context, reach: Reach) -> None:
    if context.invoked_subcommand is None:
        from gateway.people.console import command

        sys.exit(command.calibration(reach))


@app.command()
@reaches
def export(reach: Reach) -> None:
    """Print the whole calibration as JSON, for `import` and for programs."""
    from gateway.people.commands import calibration

    sys.exit(calibration.export(reach.connection(_SOURCE)))


@app.command("import")
@reaches
def import_file(
    *,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A file that `export` printed; - for stdin.")],
    yes: YesOption = False,
    reach: Reach,
) -> None:
    """Replace the whole calibration, also a broken one, with a file. Servos that it does not name become as drawn."""
    from gateway.people.commands import calibration

    sys.exit(calibration.import_file(reach.connection(_SOURCE), file, agreed=yes))


@app.command()
@reaches
def landing(*, leg: LegOption = None, yes: YesOption = False, reach: Reach) -> None:
    """Record the landing pose: the angles of the servos that run now."""
    from gateway.people.commands import calibration

    sys.exit(calibration.landing(reach.connection(_SOURCE), leg or [], agreed=yes))
