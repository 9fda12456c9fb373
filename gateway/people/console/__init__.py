"""The console: a web page that shows the robot and drives it, served by a process that is one more Zenoh client.

Here is the command line alone.
"""

import sys
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

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
