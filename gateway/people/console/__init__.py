"""The console: a web page that shows the robot and drives it, served by a process that is one more Zenoh client.

Here are the command lines alone: of `console`, and of `calibrate`, whose guide is a card of the page.
"""

import sys
from pathlib import Path
from typing import Annotated, Final, Literal, NamedTuple

import typer

from gateway.people.commands.options import AdaptOption, OtherShapeOption, Reach, reaches

app = typer.Typer()


class ConsoleOptions(NamedTuple):
    """The options of a console that serves."""

    listen: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="The address for browsers. Default: 127.0.0.1:8080, or the next free port.",
        ),
    ] = None
    reach: Reach = Reach()
    cert: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="The console's TLS certificate (PEM), made by `certs issue --role console`."),
    ] = None
    key: Annotated[Path | None, typer.Option(metavar="PATH", help="The certificate's private key.")] = None
    host: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="A name by which browsers may reach it through a proxy. Repeatable."),
    ] = None
    role: Annotated[
        Literal["operator", "button", "observer"],
        typer.Option(help="What pages may do. operator: drive and stop. button: only stop. observer: only watch."),
    ] = "operator"
    geometry: OtherShapeOption = None
    adapt: AdaptOption = False
    open_browser: Annotated[bool, typer.Option("--open", help="Open the page in this machine's browser.")] = False
    phone: Annotated[
        bool,
        typer.Option(
            "--phone", help="Serve a phone in this network: print a QR code, and make a certificate if there is none."
        ),
    ] = False
    camera: Annotated[
        list[str] | None,
        typer.Option(metavar="[NAME=]URL", envvar="HEXAPOD_CONSOLE__CAMERA", help="Show an MJPEG stream. Repeatable."),
    ] = None
    camera_stale_ms: Annotated[
        float, typer.Option(metavar="MS", min=0, help="An older picture moves nothing; 0: any does.")
    ] = 500.0


@app.command("console")
@reaches
def serve_or_link(
    *,
    options: ConsoleOptions,
    link: Annotated[
        bool, typer.Option("--link", help="Print a link to the running console (at --listen), for another browser.")
    ] = False,
    sign_out: Annotated[
        bool,
        typer.Option("--sign-out", help="End all sessions and links of this user's consoles (root: the service's)."),
    ] = False,
) -> None:
    """Serve a web page that shows the robot and drives it; STOP ALL is one tap.

    The console is a client of the gateway, and waits if no gateway runs yet. A link works once. A session ends after
    12 hours. Other machines need TLS: --cert and --key, or --phone.
    """
    from gateway.people.console import command

    if sign_out or link:
        sys.exit(command.sign_out() if sign_out else command.link(options.listen))
    command.console(options)


# ---- calibrate: one call of commands/calibration.py each; without a command, the guide

_SOURCE: Final = "hexapod-gateway calibrate"
calibrate_app = typer.Typer(
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


@calibrate_app.callback()
@reaches
def guide(*, context: typer.Context, reach: Reach) -> None:
    if context.invoked_subcommand is None:
        from gateway.people.console import command

        sys.exit(command.calibration(reach))


@calibrate_app.command()
@reaches
def export(reach: Reach) -> None:
    """Print the whole calibration as JSON, for `import` and for programs."""
    from gateway.people.commands import calibration

    sys.exit(calibration.export(reach.connection(_SOURCE)))


@calibrate_app.command("import")
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


@calibrate_app.command()
@reaches
def landing(*, leg: LegOption = None, yes: YesOption = False, reach: Reach) -> None:
    """Record the landing pose: the angles of the servos that run now."""
    from gateway.people.commands import calibration

    sys.exit(calibration.landing(reach.connection(_SOURCE), leg or [], agreed=yes))
