"""`hexapod-gateway certs`: arguments in, one call of gateway.certs, a few lines out that say what to do next."""

import datetime as dt
from pathlib import Path
from typing import Annotated

import typer

from gateway import certs
from gateway.certs import expiry, pool
from gateway.people.terminal import this_command

WIDE = 100

app = typer.Typer(
    no_args_is_help=True,
    help="Certificates: who may reach the robot over the network, and as what.\n\n"
    "`init` makes a private certificate authority (CA) and the robot's files, once. `issue` makes a laptop's files and "
    "changes nothing on the robot. "
    "An operator commands and watches, an observer only watches, a button stops, watches and moves nothing, anyone "
    "else gets nothing.\n\n"
    "Keep the folder on a machine you trust, not on the robot: whoever has its ca.key can let anyone in.\n\n"
    "Exit codes: 0 done, 2 an argument or the folder is wrong, and nothing was changed.",
)

Directory = Annotated[
    Path,
    typer.Option(
        "--dir", metavar="D", help="The folder with the CA. Example: --dir ~/hexapod-certs", show_default=False
    ),
]
Days = Annotated[
    int,
    typer.Option(
        metavar="N",
        help="How many days the certificate is good for (never longer than its CA, 10 years). Example: --days 90",
    ),
]


@app.command(epilog="Example: hexapod-gateway certs init --dir ~/hexapod-certs --host robot.local --host 192.0.2.7")
def init(
    directory: Directory,
    host: Annotated[
        list[str],
        typer.Option(
            metavar="HOST",
            help="A name or address by which laptops reach the robot, in a fleet the router; repeat it for each. "
            "Laptops reject it under any other. Example: --host robot.local --host 192.0.2.7",
            show_default=False,
        ),
    ],
    port: Annotated[int, typer.Option(metavar="N", help="The port the robot listens on. Example: --port 7447")] = 7447,
    namespace: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="A name before all keys of this robot, where several share a network without a router. "
            "Example: --namespace robot-7",
            show_default=False,
        ),
    ] = "",
    size: Annotated[
        int,
        typer.Option(
            "--pool", metavar="N", help="How many laptops of each role the rules know in advance. Example: --pool 256"
        ),
    ] = pool.SIZE,
    days: Days = certs.LEAF_DAYS,
) -> None:
    """Make a private CA, the robot's certificate, and a Zenoh configuration that admits only certificates of this CA.

    It never overwrites a file: a folder that has a CA already is an error, and then nothing is changed.
    """
    certs.init(directory, host, days=days, port=port, namespace=namespace, size=size)
    typer.echo(f"Made a CA and the gateway's files in {directory}.")
    files = " ".join(str(directory / name) for name in ("gateway.json5", "gateway.pem", "gateway.key", "ca.pem"))
    typer.echo("Leave ca.key here, and keep a copy of it somewhere safe.")
    typer.echo(
        f"If {host[0]} is the router of a fleet, gateway.key is the router's, and each robot gets its own. Next: "
        f"{this_command()} certs robot NAME --dir {directory}"
    )
    typer.echo(f"If {host[0]} is the robot: its files, and how they get into its service:")
    typer.echo(f"  ssh {host[0]} mkdir -p -m 700 robot-certs")
    typer.echo(f"  scp {files} {host[0]}:robot-certs/")
    typer.echo("and on the robot, in the repository's folder: sudo deploy/install.sh --certs ~/robot-certs")
    typer.echo(
        f"Next, for each laptop: {this_command()} certs issue NAME --role operator --dir {directory} --bundle NAME.zip"
    )


@app.command(
    epilog="Example: hexapod-gateway certs issue alice --role operator --dir ~/hexapod-certs --bundle alice.zip"
)
def issue(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="The laptop or its owner: letters, digits, - and _. Example: alice", show_default=False
        ),
    ],
    role: Annotated[
        str,
        typer.Option(
            metavar="ROLE",
            help="operator: commands and watches. observer: only watches. button: stops and watches, and moves "
            "nothing. Example: --role observer",
            show_default=False,
        ),
    ],
    directory: Directory,
    robot: Annotated[
        str,
        typer.Option(
            metavar="ROBOT",
            help="In a fleet: the one robot that it is for, as `certs robot` named it. Example: --robot robot-7",
            show_default=False,
        ),
    ] = "",
    bundle: Annotated[
        Path | None,
        typer.Option(
            metavar="ZIP",
            help="Also put all that the laptop needs into this zip, its key included: hand it over in private. "
            "Example: --bundle alice.zip",
            show_default=False,
        ),
    ] = None,
    days: Days = certs.LEAF_DAYS,
    absolute: Annotated[
        bool,
        typer.Option(
            "--absolute",
            help="Name the files in NAME.json5 by their full paths, for other Zenoh programs (not in the zip).",
        ),
    ] = False,
) -> None:
    """Make a laptop's certificate and NAME.json5, ready for --zenoh-config. Nothing changes on the robot.

    Lost: `certs revoke NAME`. Each laptop takes a common name of the pool that the robot's rules list, for good.
    """
    certs.issue(directory, name, role, robot=robot, bundle=bundle, days=days, absolute=absolute)
    made = certs.describe(directory / f"{name}.pem")
    typer.echo(
        f"Made {name}, {role}{f' of {robot}' if robot else ''} ({made.common_name}), in {directory}: {name}.json5 "
        f"{name}.pem {name}.key"
    )
    if pool.holder(made.common_name).number is None:
        typer.echo(
            f"All of {role} share this common name, so it cannot be revoked alone: {this_command()} certs pool --dir "
            f"{directory}, the same on the robot, and {this_command()} certs reissue {name} --dir {directory}"
        )
    if bundle is not None:
        typer.echo(
            f"All that the laptop needs is in {bundle}, its key included: hand it over in private, then delete it."
        )
    typer.echo(f"Try it: {this_command()} watch --zenoh-config {directory / name}.json5")


@app.command(epilog="Example: hexapod-gateway certs robot robot-1 robot-2 --dir ~/fleet")
def robot(
    directory: Directory,
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME...]",
            help="Each robot's name, which is its namespace on the router: letters, digits, - and _. "
            "Example: robot-1 robot-2. Without one, only router.json5 is made anew",
            show_default=False,
        ),
    ] = None,
    days: Days = certs.LEAF_DAYS,
) -> None:
    """Add robots to a fleet behind one Zenoh router, whose hosts `certs init` was given. Rewrites router.json5."""
    certs.add_robots(directory, names or (), days=days)
    if not names:
        typer.echo(f"Made {directory}/router.json5 anew. Copy it to the router, and restart that.")
        return
    first = names[0]
    typer.echo(f"Made {', '.join(names)} in {directory}, and router.json5 for all robots there.")
    typer.echo("Copy to the router, and restart it: router.json5 gateway.pem gateway.key ca.pem")
    typer.echo(f"Copy to each robot, as to {first}: {first}.json5 {first}.pem {first}.key ca.pem. In its gateway.toml:")
    typer.echo(f'  [zenoh]\n  listen = []\n  config = "/etc/hexapod-gateway/zenoh/{first}.json5"')
    typer.echo(f"For its people: {this_command()} certs issue NAME --role operator --robot {first} --dir {directory}")


@app.command(epilog="Example: hexapod-gateway certs console --host robot.local --dir ~/hexapod-certs")
def console(
    host: Annotated[
        list[str],
        typer.Option(
            metavar="HOST",
            help="A name or address by which browsers reach it; repeat it for each. Example: --host robot.local",
            show_default=False,
        ),
    ],
    directory: Directory,
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="What its files are called. Example: tablet-console")
    ] = "web",
    days: Days = certs.CONSOLE_DAYS,
) -> None:
    """Make a TLS certificate for a web console that other machines reach, of at most 459 days.

    Browsers trust it once NAME-ca.pem is among their authorities, which is good for these hosts and nothing else. Keep
    NAME-ca.key beside ca.key. On Zenoh neither is good for anything.
    """
    certs.console(directory, name, host, days=days)
    typer.echo(f"Made {name}.pem and {name}.key in {directory}: copy both to the machine of the console, and there:")
    command = f"hexapod-gateway console --listen 0.0.0.0:8443 --cert {name}.pem --key {name}.key"
    typer.echo(f"  {command} --zenoh-config PERSON.json5")
    typer.echo(f"In each browser, import {directory / f'{name}-ca.pem'} as an authority, once.")


@app.command(epilog="Example: hexapod-gateway certs renew gateway --dir ~/hexapod-certs")
def renew(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help='A laptop, or "gateway" for the robot. Example: gateway', show_default=False
        ),
    ],
    directory: Directory,
    host: Annotated[
        list[str] | None,
        typer.Option(
            metavar="HOST",
            help="For the robot, or a console: one more name or address by which it is reached; repeat it for each. "
            "The old ones stay. Example: --host 192.0.2.9",
            show_default=False,
        ),
    ] = None,
    days: Days = certs.LEAF_DAYS,
) -> None:
    """Extend a certificate before it expires, or give the robot a further address, with no new CA.

    Its key stays, so only NAME.pem has to be copied again.
    """
    path = certs.renew(directory, name, hosts=host or (), days=days)
    left = certs.describe(path)
    typer.echo(f"{path} is good until {left.not_after:%Y-%m-%d}: copy it over the old one on {_where(name)}.")
    if host and name == "gateway":
        typer.echo(
            "Laptops that are issued from now on dial it, too; an older NAME.json5 stays good: add the address to its "
            f"connect.endpoints, or give --connect tls/{host[0]}:PORT beside --zenoh-config"
        )


@app.command("list", epilog="Example: hexapod-gateway certs list --dir ~/hexapod-certs")
def show(directory: Directory) -> None:
    """List all certificates: name, role, expiry, days left, serial number, common name, and how it stands with each.

    `good`, `older CA` (move it: certs reissue), `replaced` (still good: revoke it by its common name once it is not in
    use any more), `revoked`, `expired`. Tab-separated if not on a terminal.
    """
    from rich.console import Console
    from rich.table import Table

    now = dt.datetime.now(dt.UTC)
    head = ("NAME", "ROLE", "EXPIRES", "DAYS LEFT", "SERIAL", "COMMON NAME", "STATE")
    rows = [
        (
            found.name,
            found.role,
            f"{found.not_after:%Y-%m-%d}",
            str(found.days_left(now)),
            found.serial,
            found.common_name,
            state,
        )
        for found, state in certs.states(directory, now)
    ]
    console = Console()
    if not console.is_terminal:
        for row in (head, *rows):
            typer.echo("\t".join(row))
        return
    table = Table(padding=(0, 0) if console.width < WIDE else (0, 1))
    for title in head:
        table.add_column(
            title.capitalize(),
            justify="right" if title == "DAYS LEFT" else "left",
            overflow="fold",
            no_wrap=title != "SERIAL",
        )
    for row in rows:
        left = int(row[3])
        style = "yellow" if left < expiry.WARN_DAYS or row[-1] in ("older CA", "replaced") else None
        table.add_row(*row, style="red" if row[-1] in ("expired", "revoked") else style)
    console.print(table)


def _where(name: str) -> str:
    return "the robot, and restart the service" if name == "gateway" else f"{name}'s machine"
