"""The command line of `check`. It imports the checks late: an emergency stop must not wait for them."""

import sys
from typing import Annotated

import typer

from gateway.errors import ConfigError
from gateway.people.commands.options import ConfigOption, ConnectOption, TimeoutOption, ZenohConfigOption

app = typer.Typer()


@app.command()
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
