"""`hexapod-gateway lease`: arguments in, one call of tools/driving.py each."""

import sys
from typing import Annotated

import typer

from gateway.people.tools.options import ConnectOption, TimeoutOption, ZenohConfigOption

app = typer.Typer(
    no_args_is_help=True,
    help="Who is driving: while somebody holds the lease, nobody else's starts, sets and resets count. Stops and the "
    "emergency stop are taken from anyone, always.\n\n"
    "`acquire` and `take` hold it for as long as they run, and renew it: end them with Ctrl-C, with --for, or with "
    "`release` in a second terminal. Meanwhile `send` and `reset` of the same user drive under it; its token lies in a "
    "file that only that user may read.\n\n"
    "Exit codes: 0 done, 1 rejected (the reason is printed) or lost, 4 no gateway answers.",
)

ForOption = Annotated[
    float, typer.Option("--for", metavar="S", min=0, help="Hold it for this many seconds. 0: until Ctrl-C.")
]


@app.command()
def status(connect: ConnectOption = None, zenoh_config: ZenohConfigOption = None, timeout: TimeoutOption = 2.0) -> None:
    """Show who drives, and who asks for the lease."""
    from gateway.people.tools import driving

    sys.exit(driving.status(driving.connection(connect, zenoh_config, timeout)))


@app.command()
def acquire(
    hold: ForOption = 0,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Drive, if nobody else does: hold the lease until Ctrl-C."""
    from gateway.people.tools import driving

    sys.exit(driving.hold(driving.connection(connect, zenoh_config, timeout), for_s=hold))


@app.command()
def ask(
    wait: Annotated[
        float, typer.Option("--wait", metavar="S", min=0, help="How long to wait to be handed it, in seconds.")
    ] = 30,
    hold: ForOption = 0,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Ask the driver, wait to be handed the lease, and hold it until Ctrl-C. The robot goes on moving meanwhile."""
    from gateway.people.tools import driving

    sys.exit(driving.hold(driving.connection(connect, zenoh_config, timeout), for_s=hold, wait_s=wait))


@app.command()
def take(
    yes: Annotated[bool, typer.Option("--yes", help="Without asking first.")] = False,
    hold: ForOption = 0,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Take the lease from the driver, by force: all six legs stop first. Asks before it does."""
    from gateway.people.tools import driving

    sys.exit(driving.take(driving.connection(connect, zenoh_config, timeout), agreed=yes, for_s=hold))


@app.command()
def release(
    to: Annotated[
        str | None,
        typer.Option("--to", metavar="NAME", help="Hand it over to who asked for it; the robot goes on moving."),
    ] = None,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Release the lease that this user's `acquire`, `ask` or `take` holds on this machine."""
    from gateway.people.tools import driving

    sys.exit(driving.release(driving.connection(connect, zenoh_config, timeout), to))
