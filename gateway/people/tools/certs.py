"""`hexapod-gateway certs`: arguments in, one call of gateway.certs, and a few lines that state what to do next."""

import datetime as dt
from pathlib import Path
from typing import Annotated

import typer

from gateway import certs
from gateway.certs import expiry, pool
from gateway.errors import ConfigError
from gateway.people.terminal import this_command

WIDE = 100

app = typer.Typer(
    no_args_is_help=True,
    help="Certificates: who may reach the robot over the network, and as what.\n\n"
    "`init` makes a private certificate authority (CA) and the robot's files, once. `issue` makes a laptop's files and "
    "changes nothing on the robot. "
    "An operator commands and watches, an observer only watches, a button stops, watches and moves nothing, anyone "
    "else gets nothing.\n\n"
    "Keep the folder on a machine you trust, not on the robot: anyone with its ca.key can admit anyone.\n\n"
    "Exit codes: 0 done, 2 an argument or the folder is wrong, and nothing was changed.",
)

Directory = Annotated[
    Path,
    typer.Option("--dir", metavar="D", help="The folder with the CA. Example: --dir ~/hexapod-certs"),
]
Days = Annotated[
    int,
    typer.Option(
        metavar="N",
        min=1,
        max=certs.CA_DAYS,
        help="How many days the certificate is good for (never longer than its CA, 10 years). Example: --days 90",
    ),
]
Bundle = Annotated[
    Path | None,
    typer.Option(
        metavar="ZIP",
        help="Also put all that the laptop needs into this zip, its key included: hand it over in private. "
        "Example: --bundle alice.zip",
    ),
]
OthersToo = Annotated[bool, typer.Option("--others-too", help="Also where others are concerned, whom it then names.")]


@app.command(epilog="Example: hexapod-gateway certs init --dir ~/hexapod-certs --host robot.local --host 192.0.2.7")
def init(
    directory: Directory,
    host: Annotated[
        list[str],
        typer.Option(
            metavar="HOST",
            help="A name or address by which laptops reach the robot, in a fleet the router; repeat it for each. "
            "Laptops reject it under any other. Example: --host robot.local --host 192.0.2.7",
        ),
    ],
    port: Annotated[
        int, typer.Option(metavar="N", min=1, max=65535, help="The port the robot listens on. Example: --port 7447")
    ] = 7447,
    namespace: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="A name before all keys of this robot, where several share a network without a router. "
            "Example: --namespace robot-7",
        ),
    ] = "",
    size: Annotated[
        int,
        typer.Option(
            "--pool",
            metavar="N",
            min=1,
            max=pool.MAX_POOL,
            help="How many laptops of each role the rules know in advance. Example: --pool 256",
        ),
    ] = pool.SIZE,
    days: Days = certs.LEAF_DAYS,
) -> None:
    """Make a private CA, the robot's certificate, and a Zenoh configuration that admits only certificates of this CA.

    It never overwrites a file: a folder that has a CA already is an error, and then nothing is changed.
    """
    certs.folder.init(directory, host, days=days, port=port, namespace=namespace, size=size)
    typer.echo(f"Made a CA and the gateway's files in {directory}.")
    files = " ".join(str(directory / name) for name in ("gateway.json5", "gateway.pem", "gateway.key", "ca.pem"))
    typer.echo("Leave ca.key here, and keep a copy of it somewhere safe.")
    typer.echo(
        f"If {host[0]} is the router of a fleet, gateway.key is the router's, and each robot gets its own. Next: "
        f"{this_command()} certs robot NAME --dir {directory}"
    )
    typer.echo(f"If {host[0]} is the robot: its files, and how they get into its service:")
    _echo_installation(host[0], files)
    typer.echo(
        f"Next, for each laptop: {this_command()} certs issue NAME --role operator --dir {directory} --bundle NAME.zip"
    )


def _echo_installation(host: str, files: str) -> None:
    typer.echo(f"  ssh {host} mkdir -p -m 700 robot-certs")
    typer.echo(f"  scp {files} {host}:robot-certs/")
    typer.echo("and on the robot, in the repository's folder: sudo deploy/install.sh --certs ~/robot-certs")


@app.command(
    epilog="Example: hexapod-gateway certs issue alice --role operator --dir ~/hexapod-certs --bundle alice.zip"
)
def issue(
    name: Annotated[
        str,
        typer.Argument(metavar="NAME", help="The laptop or its owner: letters, digits, - and _. Example: alice"),
    ],
    role: Annotated[
        str,
        typer.Option(
            metavar="ROLE",
            help="operator: commands and watches. observer: only watches. button: stops and watches, and moves "
            "nothing. Example: --role observer",
        ),
    ],
    directory: Directory,
    robot: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROBOT",
            help="In a fleet: the robot that it is for, as `certs robot` named it; repeat it for each. "
            "Example: --robot robot-7",
        ),
    ] = None,
    all_robots: Annotated[
        bool, typer.Option("--all-robots", help="In a fleet: for all robots, also for those that are added later.")
    ] = False,
    bundle: Bundle = None,
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
    if all_robots and robot:
        raise ConfigError("give --robot or --all-robots, not both")
    robots = (pool.ALL,) if all_robots else tuple(robot or ())
    paths = certs.folder.issue(directory, name, role, robots=robots, bundle=bundle, days=days, absolute=absolute)
    made = certs.folder.describe(directory / f"{name}.pem")
    whose = " of all robots" if all_robots else f" of {', '.join(robots)}" if robots else ""
    router = directory / certs.folder.ROUTER_FILE
    files = [path.name for path in paths if path not in (bundle, router)]
    typer.echo(f"Made {name}, {role}{whose} ({made.common_name}), in {directory}: {' '.join(files)}")
    if router in paths:
        typer.echo(f"The router has to know: copy {router} to it, and restart it.")
    if pool.holder(made.common_name).number is None:
        typer.echo(
            f"All of {role} share this common name, so it cannot be revoked alone: {this_command()} certs pool --dir "
            f"{directory}, the same on the robot, and {this_command()} certs reissue {name} --dir {directory}"
        )
    if bundle is not None:
        typer.echo(
            f"All that the laptop needs is in {bundle}, its key included: hand it over in private, then delete it."
        )
    config = next(path for path in paths if path.suffix == ".json5")
    typer.echo(f"Try it: {this_command()} watch --zenoh-config {config}")


@app.command(epilog="Example: hexapod-gateway certs robot robot-1 robot-2 --dir ~/fleet")
def robot(
    directory: Directory,
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME...]",
            help="Each robot's name, which is its namespace on the router: letters, digits, - and _. "
            "Example: robot-1 robot-2. Without one, only router.json5 is made anew",
        ),
    ] = None,
    days: Days = certs.LEAF_DAYS,
) -> None:
    """Add robots to a fleet behind one Zenoh router, whose hosts `certs init` was given. Rewrites router.json5."""
    paths = certs.folder.add_robots(directory, names or (), days=days)
    if not names:
        typer.echo(f"Made {directory}/router.json5 anew. Copy it to the router, and restart that.")
        return
    first = names[0]
    typer.echo(f"Made {', '.join(names)} in {directory}, and router.json5 for all robots there.")
    typer.echo("Copy to the router, and restart it: router.json5 gateway.pem gateway.key ca.pem")
    files = [f"{first}.json5", f"{first}.pem", f"{first}.key", "ca.pem"]
    files += [certs.revocation.REVOCATION_FILE] * (directory / certs.revocation.REVOCATION_FILE).exists()
    typer.echo(f"For each robot, as for {first}: its files, and how they get into its service:")
    _echo_installation(first, " ".join(str(directory / file) for file in files))
    peoples = [path.name for path in paths if path.stem.count(".")]
    if peoples:
        typer.echo(f"Copy to the people who have a certificate for all robots: {' '.join(peoples)}")
    typer.echo(f"For its people: {this_command()} certs issue NAME --role operator --robot {first} --dir {directory}")


@app.command(epilog="Example: hexapod-gateway certs console --host robot.local --dir ~/hexapod-certs")
def console(
    host: Annotated[
        list[str],
        typer.Option(
            metavar="HOST",
            help="A name or address by which browsers reach it; repeat it for each. Example: --host robot.local",
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
    NAME-ca.key next to ca.key. On Zenoh neither is good for anything.
    """
    certs.folder.console(directory, name, host, days=days)
    typer.echo(f"Made {name}.pem and {name}.key in {directory}: copy both to the machine of the console, and there:")
    command = f"hexapod-gateway console --listen 0.0.0.0:8443 --cert {name}.pem --key {name}.key"
    typer.echo(f"  {command} --zenoh-config PERSON.json5")
    typer.echo(f"In each browser, import {directory / f'{name}-ca.pem'} as an authority, once.")


@app.command(epilog="Example: hexapod-gateway certs renew gateway --dir ~/hexapod-certs")
def renew(
    name: Annotated[
        str,
        typer.Argument(metavar="NAME", help='A laptop, or "gateway" for the robot. Example: gateway'),
    ],
    directory: Directory,
    host: Annotated[
        list[str] | None,
        typer.Option(
            metavar="HOST",
            help="For the robot, or a console: one more name or address by which it is reached; repeat it for each. "
            "The old ones stay. Example: --host 192.0.2.9",
        ),
    ] = None,
    days: Days = certs.LEAF_DAYS,
) -> None:
    """Extend a certificate before it expires, or give the robot a further address, with no new CA.

    Its key stays, so only NAME.pem has to be copied again.
    """
    path = certs.folder.renew(directory, name, hosts=host or (), days=days)
    left = certs.folder.describe(path)
    typer.echo(f"{path} is good until {left.not_after:%Y-%m-%d}: copy it over the old one on {_where(name)}.")
    if host and name == "gateway":
        typer.echo(
            "Laptops that are issued from now on dial it, too; an older NAME.json5 stays good: add the address to its "
            f"connect.endpoints, or give --connect tls/{host[0]}:PORT with --zenoh-config"
        )


@app.command("list", epilog="Example: hexapod-gateway certs list --dir ~/hexapod-certs")
def show(directory: Directory) -> None:
    """List all certificates: name, role, expiry, days left, serial number, common name, and how it stands with each.

    `good`, `older CA` (move it: certs reissue), `replaced` (still good: revoke it by its common name once it is not in
    use any more), `revoked`, `expired`. LIST: the list of revoked certificates that a robot has confirmed (`2, not 3`).
    Tab-separated if not on a terminal.
    """
    from rich.console import Console
    from rich.table import Table

    now = dt.datetime.now(dt.UTC)
    lists = certs.confirmed.shown(directory)
    head = ("NAME", "ROLE", "EXPIRES", "DAYS LEFT", "SERIAL", "COMMON NAME", "STATE", *["LIST"] * bool(lists))
    found = [(each, each.days_left(now), state) for each, state in certs.moving.states(directory, now)]
    rows = [
        (each.name, each.role, f"{each.not_after:%Y-%m-%d}", str(left), each.serial, each.common_name, state)
        + ((lists.get(each.path.stem, ""),) if lists else ())
        for each, left, state in found
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
    for row, (_, left, state) in zip(rows, found, strict=True):
        style = "yellow" if left < expiry.WARN_DAYS or state in ("older CA", "replaced") else None
        table.add_row(*row, style="red" if state in ("expired", "revoked") else style)
    console.print(table)


def _where(name: str) -> str:
    return "the robot, and restart the service" if name == "gateway" else f"{name}'s machine"


@app.command(epilog="Example: hexapod-gateway certs revoke alice --dir ~/hexapod-certs")
def revoke(
    directory: Directory,
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME]",
            help="The person or laptop, with all certificates it ever had; or one common name, such as operator-07. "
            "Without it, the list as it is goes to the robots",
        ),
    ] = None,
    to: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROBOT",
            help="Only to this robot; repeat it for each. In a fleet its name, else a host or an endpoint. "
            "Example: --to robot-3, or --to tls/192.0.2.7:7447",
        ),
    ] = None,
    zenoh_config: Annotated[
        Path | None,
        typer.Option(
            "--zenoh-config",
            metavar="PATH",
            help="Whose connection it is. Default: for each robot, an operator's in the folder who is not shut out.",
        ),
    ] = None,
    others_too: OthersToo = False,
) -> None:
    """Shut a laptop out: it is lost, stolen, or no longer anybody's.

    Signs a list (revoked.crl, an X.509 CRL) whose number only grows. A robot that gets it stops all legs, starts anew
    within three seconds, and from then on the laptop gets nothing: Zenoh drops what it sends, its proofs for the lease
    are rejected. Nobody else has to do anything. To undo it, `certs issue` the name anew.

    The list goes to all robots that the folder knows, one after the other, over an operator's connection. A robot that
    is off gets it later: `certs revoke` without a name, or the file: `sudo hexapod-gateway revoke FILE` there.
    `certs list` names the list that each robot has confirmed.

    Exit codes: 0 all have confirmed it, 1 one has not (the list is signed, and can be brought later), 2 an argument or
    the folder is wrong.
    """
    from gateway.people.tools import revoking

    raise typer.Exit(revoking.revoke(directory, name, to or [], zenoh_config, others_too=others_too))


@app.command(epilog="Example: hexapod-gateway certs reissue alice --dir ~/hexapod-certs --bundle alice.zip")
def reissue(
    name: Annotated[str, typer.Argument(metavar="NAME", help="The laptop, as `certs list` names it. Example: alice")],
    directory: Directory,
    bundle: Bundle = None,
    days: Days = certs.LEAF_DAYS,
) -> None:
    """Give a laptop another certificate: new key, a common name of its own, signed by the newest CA.

    For laptops of the layout before (common name `operator`), which cannot be revoked one by one, and for another CA.
    What it has now goes on working until it expires or is revoked; its files move to the folder `earlier`.
    """
    paths = certs.moving.reissue(directory, name, bundle=bundle, days=days)
    made = certs.folder.describe(directory / f"{name}.pem")
    typer.echo(f"{name} is {made.common_name} now: {' '.join(path.name for path in paths)} in {directory}.")
    typer.echo(f"Bring them to {name}'s machine, in place of the old ones; these still work.")
    typer.echo(f"Once they are gone: {this_command()} certs list --dir {directory} names what can be revoked.")


@app.command("pool", epilog="Example: sudo hexapod-gateway certs pool --dir /etc/hexapod-gateway/zenoh")
def set_pool(
    directory: Directory,
    size: Annotated[
        int,
        typer.Option(metavar="N", min=1, max=pool.MAX_POOL, help="How many laptops of each role. Example: --size 128"),
    ] = pool.SIZE,
) -> None:
    """Let the rules in gateway.json5 know so many common names of each role, so that each laptop can have its own.

    Once for a folder of the layout before, where all operators share one, and again when the pool is used up. In the
    folder with the CA, and in that on the robot; what else is written in the file stays.
    """
    for path in certs.moving.set_pool(directory, size):
        typer.echo(f"{path} lists at least {size} common names of each role.")
    typer.echo(
        "If this is the robot: sudo systemctl restart hexapod-gateway (all legs stop). A router: restart it, too."
    )


@app.command("replace-ca", epilog="Example: hexapod-gateway certs replace-ca --dir ~/hexapod-certs")
def replace_ca(directory: Directory) -> None:
    """Make a new CA next to the old one; both are good until `drop-ca`. Laptops move over one by one (`reissue`)."""
    paths = certs.moving.replace_ca(directory)
    here = this_command()
    typer.echo("Made a new CA; the old one stays good. Keep a copy of ca.key somewhere safe. Then, in this order:")
    typer.echo(f"1. To the robot: {directory}/ca.pem, and there, with its size: sudo {here} certs pool --size N")
    typer.echo(f"   (or {' and '.join(path.name for path in paths)} together), and restart the service.")
    typer.echo(f"2. For each laptop: {here} certs reissue NAME --dir {directory} --bundle NAME.zip")
    typer.echo(f"3. On the robot `sudo {here} check` counts who still comes with the old one.")
    typer.echo(f"4. {here} certs renew gateway --dir {directory}; {here} certs drop-ca --dir {directory}")
    typer.echo("   and bring gateway.pem and ca.pem to the robot, ca.pem to each laptop at leisure.")


@app.command("drop-ca", epilog="Example: hexapod-gateway certs drop-ca --dir ~/hexapod-certs")
def drop_ca(directory: Directory, others_too: OthersToo = False) -> None:
    """End the time of two CAs: ca.pem has only the new one, and certificates of the old one are good no more."""
    path = certs.moving.drop_ca(directory, others_too=others_too)
    typer.echo(f"{path} has the new CA only: bring it to the robot, and restart the service.")
