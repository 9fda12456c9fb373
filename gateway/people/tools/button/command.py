"""The command line of `button`."""

import sys
from typing import Annotated

import typer

from gateway.people.tools.options import ConnectOption, TimeoutOption, ZenohConfigOption

app = typer.Typer()


@app.command()
def button(
    name: Annotated[
        str | None,
        typer.Option("--name", metavar="N", help="By which name; with a certificate it is that of its person."),
    ] = None,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Be a stop button: any key stops the robot, and so does this terminal's silence.

    It checks in with the gateway as long as this terminal is drawn. Where `buttons.required` asks for a button, nothing
    moves without one; if this laptop leaves the Wi-Fi, sleeps or dies, all six legs stop within `buttons.timeout_ms`.

    Ctrl-C leaves on purpose; the robot stops then, too, if too few buttons remain. A certificate for this alone, which
    moves nothing: `hexapod-gateway certs issue NAME --role button`.

    Exit codes: 0 left on purpose, 1 refused (or no terminal), 4 no gateway.
    """
    from gateway.people.tools import reach
    from gateway.people.tools.button import screen

    sys.exit(screen.hold(reach.connection(connect, zenoh_config, timeout, source=screen.called(name)), name))
