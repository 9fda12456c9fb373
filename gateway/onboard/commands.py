"""The command lines of `check`, `setup` and the black box's `incidents`.

They import the rest late: an emergency stop must not wait for it.
"""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gateway.errors import ConfigError
from gateway.model.protocols import SpiProtocol
from gateway.people.commands.options import ConfigOption, ConnectOption, JsonOption, TimeoutOption, ZenohConfigOption

if TYPE_CHECKING:
    from gateway.onboard.black_box import BlackBox

check_app = typer.Typer()
setup_app = typer.Typer(add_completion=False)
incidents_app = typer.Typer(
    help="List and explain the stops and faults that the black box recorded.\n\n"
    "The black box survives a crash of the gateway. A power cut or a reboot erases it. Use sudo to read the service's.",
    invoke_without_command=True,
)


@check_app.command()
def check(
    config: ConfigOption = None,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
    move: Annotated[bool, typer.Option("--move", help="Start one servo, move it by 5°, stop all. It asks.")] = False,
    stops: Annotated[bool, typer.Option("--stops", help="Prove step by step that the gateway stops. It asks.")] = False,
    wire: Annotated[bool, typer.Option("--wire", help="Test your own plug-in, without a gateway. It asks.")] = False,
    leg: Annotated[int, typer.Option(metavar="N", min=1, max=6, help="With --stops: the leg that moves.")] = 1,
    only: Annotated[list[str] | None, typer.Option(metavar="STEP", help="With --stops: only this; repeatable.")] = None,
    late: Annotated[float, typer.Option(metavar="MS", min=1, help="With --stops: the longest delay of a Stop.")] = 20.0,
    restart: Annotated[bool, typer.Option("--restart", help="With --stops, as root: also kill the service.")] = False,
    unplug: Annotated[bool, typer.Option("--unplug", help="With --stops, --wire: ask you to unplug wires.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask first (--move: servo 61, 90°).")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, for programs; not with --move.")] = False,
) -> None:
    """Show what is missing on this machine to run the service, line by line, with the command that fixes it.

    With --zenoh-config or --connect it shows whether this laptop reaches the gateway, and what it may do there. With
    --config it checks this machine in any case.

    Without --move, --stops and --wire it changes nothing: no byte reaches the servos, and a running gateway is not
    disturbed. As root it checks with the rights of the service's user.

    Run --stops after each change, before people come near. It moves one servo by 5°, and stops everything at its end,
    also on Ctrl-C. It measures from the frames if the gateway publishes them (telemetry.frames).
    """
    if move + stops + wire > 1:
        raise ConfigError("one of --move, --stops and --wire at a time")
    if not stops and (only or restart or (unplug and not wire)):
        raise ConfigError("--only, --restart and --unplug go with --stops")
    if wire:
        from gateway.onboard.check.conformance import conformance

        sys.exit(conformance(config, agreed=yes, unplug=unplug))
    if move and as_json:
        raise ConfigError("--move asks a person, so it has no --json")
    if move or stops:
        from gateway.onboard.check.move import StopsOptions
        from gateway.onboard.check.move import move as move_servo
        from gateway.onboard.check.stops import stops as prove_stops
        from gateway.people.commands import reach

        connection = reach.connection(connect, zenoh_config, timeout, source="hexapod-gateway check")
        if move:
            sys.exit(move_servo(connection, agreed=yes))
        sys.exit(prove_stops(connection, StopsOptions(leg, yes, only or (), late, restart, unplug, config, as_json)))
    from gateway.onboard.check import check, laptop, report

    if config is not None and zenoh_config is not None:
        raise ConfigError("--config checks the service, --zenoh-config a laptop: name one of them")
    if config is None and (connect is not None or zenoh_config is not None):  # HEXAPOD_CONNECT hides no named file
        sys.exit(report(laptop(connect, zenoh_config, timeout), "reach the gateway", as_json=as_json))
    sys.exit(check(config, as_json=as_json))


@setup_app.command(
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


# ---- incidents

IncidentArgument = Annotated[
    str,
    typer.Argument(metavar="ID", help="An id from `list` or from an event, or `last` for the newest."),
]


@incidents_app.callback()
def _list_without_command(context: typer.Context, config: ConfigOption = None) -> None:
    if context.invoked_subcommand is None:
        list_incidents(context, config)
    context.obj = config  # `incidents --config F show last`


def _black_box(context: typer.Context, config: Path | None) -> "BlackBox":
    from gateway.onboard.black_box import BlackBox
    from gateway.robot import settings

    # Reading needs no framing, so none is required, as with a simulated controller.
    return BlackBox(settings.load(config or context.obj, simulated=True))


@incidents_app.command("list")
def list_incidents(context: typer.Context, config: ConfigOption = None, as_json: JsonOption = False) -> None:
    """List the incidents, newest first."""
    _black_box(context, config).list_all(as_json=as_json)


@incidents_app.command()
def show(
    context: typer.Context, incident: IncidentArgument, config: ConfigOption = None, as_json: JsonOption = False
) -> None:
    """Explain what happened: commands, decisions and frames, with times relative to the stop."""
    _black_box(context, config).show(incident, as_json=as_json)


@incidents_app.command()
def export(
    context: typer.Context,
    incident: IncidentArgument,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The MCAP file to write, such as stop.mcap")],
    config: ConfigOption = None,
) -> None:
    """Write an incident as an MCAP file, for Foxglove, Lichtblick, Rerun or your own program."""
    _black_box(context, config).export(incident, file)


@incidents_app.command()
def replay(
    context: typer.Context,
    incident: IncidentArgument,
    config: ConfigOption = None,
    until: Annotated[
        str | None, typer.Option(metavar="TIME", help="End at this time, in seconds after the incident: 0.25 or -1.5.")
    ] = None,
    settings: Annotated[
        list[str], typer.Option("--set", metavar="NAME=VALUE", help="Decide with another setting. Repeatable.")
    ] = [],  # noqa: B006  (typer's way)
    as_test: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a test that decides the same, to this new file.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Decide an incident again: which rule led to which frames. Ends with 1 if other frames were written."""
    box = _black_box(context, config)
    if not box.replay(incident, until=until, changes=settings, file=as_test, as_json=as_json):
        raise typer.Exit(1)
