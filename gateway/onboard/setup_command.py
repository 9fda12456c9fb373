"""The command line of `setup`. It imports the steps late: an emergency stop must not wait for them."""

import os
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from gateway.errors import ConfigError
from gateway.model.protocols import SpiProtocol

app = typer.Typer(add_completion=False)


@app.command(
    epilog="Example: sudo hexapod-gateway setup --framing length-prefixed --certs robot.zip\n\n"
    f"Example: hexapod-gateway setup --wire {[*SpiProtocol][-1]} --dry-run"
)
def setup(
    wire: Annotated[
        SpiProtocol | None,
        typer.Option(help=f"The controller's protocol. {'. '.join(f'{each}: {each.words}' for each in SpiProtocol)}."),
    ] = None,
    framing: Annotated[
        Literal["length-prefixed", "plain"] | None,
        typer.Option(help="length-prefixed: the published STM32 firmware. plain: as in the protocol document."),
    ] = None,
    certs: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER|ZIP",
            callback=lambda path: path and path.expanduser(),
            help="The robot's certificates: a folder, or the zip of `certs issue --role robot --bundle`.",
        ),
    ] = None,
    console: Annotated[bool, typer.Option("--console", help="Also run the web console, on 127.0.0.1:8080.")] = False,
    back: Annotated[bool, typer.Option("--back", help="Go back to the release before the last upgrade.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print each change, and change nothing.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Restart the service even while a servo runs.")] = False,
) -> None:
    """Set this robot up after the package was installed, and run `check`. Run it again at any time.

    It asks for the controller's wire and framing and writes them to /etc/hexapod-gateway/gateway.toml; comments and
    other settings there stay. It switches SPI on (Raspberry Pi OS), frees the controller's UART, installs
    certificates, and starts the service. It changes only what differs.

    It restarts the service only if something changed that the service reads, and, without --force, never while a servo
    runs.
    """
    if os.geteuid() and not dry_run:
        raise ConfigError("setup needs root: begin the command with sudo; --dry-run shows what it would do")
    from gateway.onboard.setup import Wanted
    from gateway.onboard.setup import setup as set_up
    from gateway.onboard.setup.machine import Machine

    if back and (wire or framing or certs or console or force):
        raise ConfigError("--back goes with --dry-run alone")
    sys.exit(set_up(Machine(dry=dry_run, force=force), Wanted(wire, framing, certs, console, back)))
