"""`hexapod-gateway certs`: arguments in, one call of gateway.certs, and a few lines that state what to do next."""

import datetime as dt
import json
from pathlib import Path
from typing import Annotated, Literal

import typer

from gateway import certs
from gateway.certs import expiry
from gateway.own_command import this_command
from gateway.people.commands.options import JsonOption

WIDE = 100

app = typer.Typer(
    no_args_is_help=True,
    help="Certificates: who may reach the robot over the network, and as what.\n\n"
    "`init` makes a private certificate authority (CA) and the robot's files, once. `issue` makes a laptop's files and "
    "changes nothing on the robot. `revoke` shuts a lost laptop out.\n\n"
    "Keep the folder on a machine you trust, not on the robot: anyone with its ca.key can admit anyone.",
)

Directory = Annotated[
    Path, typer.Option("--dir", metavar="D", callback=Path.expanduser, help="The folder with the CA.")
]
DEFAULT_FOLDER = Path("~/hexapod-certs")
Days = Annotated[
    int,
    typer.Option(
        metavar="N", min=1, max=certs.CA_DAYS, help="Days that the certificate is valid, at most until its CA expires."
    ),
]
Hosts = Annotated[
    list[str],
    typer.Option(
        metavar="HOST", help="A name or address by which the robot or the console is reached; repeat it for each."
    ),
]


@app.command(epilog="Example: hexapod-gateway certs init --dir ~/hexapod-certs --host robot.local --host 192.0.2.7")
def init(
    host: Hosts,
    port: Annotated[int, typer.Option(metavar="N", min=1, max=65535, help="The port the robot listens on.")] = 7447,
    directory: Directory = DEFAULT_FOLDER,
    days: Days = certs.LEAF_DAYS,
) -> None:
    """Make a private CA, the robot's certificate, and a Zenoh configuration that admits only certificates of this CA.

    Laptops reach the robot by its --host only. No file is overwritten: a folder that has a CA already is an error.
    """
    certs.folder.init(directory, host, days=days, port=port)
    typer.echo(f"Made a CA and the robot's files in {directory}. Leave ca.key here, and keep a copy somewhere safe.")
    _echo_installation(host[0], directory)
    typer.echo(
        f"Next, for each laptop: {this_command()} certs issue NAME --role operator --dir {directory} --bundle NAME.zip"
    )


def _echo_installation(host: str, directory: Path, bundle: Path | None = None) -> None:
    """How a robot gets its files: the zip, or those of its folder without ca.key."""
    typer.echo("The robot's files, and how its service gets them:")
    if bundle is not None:
        typer.echo(f"  scp {bundle} {host}:")
    else:
        files = " ".join(str(directory / name) for name in certs.folder.ROBOT_FILES)
        typer.echo(f"  ssh {host} mkdir -p -m 700 robot-certs")
        typer.echo(f"  scp {files} {host}:robot-certs/")
    typer.echo(f"and on the robot: sudo hexapod-gateway setup --certs {bundle.name if bundle else 'robot-certs'}")


@app.command(
    epilog="Example: hexapod-gateway certs issue alice --role operator --dir ~/hexapod-certs --bundle alice.zip"
)
def issue(
    name: Annotated[str, typer.Argument(metavar="NAME", help="The laptop or its owner: letters, digits, - and _.")],
    role: Annotated[
        Literal["operator", "observer", "button", "robot", "console"],
        typer.Option(
            help="operator: commands and watches. observer: only watches. button: stops and watches, and moves "
            "nothing. robot: a further robot of this CA. console: a web console.",
        ),
    ],
    directory: Directory = DEFAULT_FOLDER,
    host: Hosts = [],  # noqa: B006 (read only)
    bundle: Annotated[
        Path | None,
        typer.Option(
            metavar="ZIP", help="Also put all that the laptop or robot needs into this zip, its key included."
        ),
    ] = None,
    days: Days = certs.LEAF_DAYS,
) -> None:
    """Make the files of a laptop, of a further robot, or of a web console. Nothing changes on any robot.

    A laptop of this CA reaches all its robots: NAME.json5 leads to the first, NAME.ROBOT.json5 to another. A console's
    certificate is valid for 459 days at most. Browsers trust it once NAME-ca.pem is among their authorities.
    """
    paths = certs.folder.issue(directory, name, role, hosts=host, bundle=bundle, days=days)
    files = " ".join(path.name for path in paths if path != bundle)
    typer.echo(f"Made {name}, {role}, in {directory}: {files}")
    if role == certs.folder.ROBOT:
        _echo_installation(host[0], directory / name, bundle)
        typer.echo(f"Laptops issued before reach it with --connect tls/{host[0]}:PORT --zenoh-config …")
    elif role == certs.authority.CONSOLE:
        typer.echo(f"Copy {name}.pem and {name}.key to the machine of the console, and there:")
        command = f"hexapod-gateway console --listen 0.0.0.0:8443 --cert {name}.pem --key {name}.key"
        typer.echo(f"  {command} --zenoh-config PERSON.json5")
        typer.echo(f"In each browser, import {directory / f'{name}-ca.pem'} as an authority, once.")
    else:
        if bundle is not None:
            typer.echo(
                f"All that the laptop needs is in {bundle}, its key too: hand it over in private, then delete it."
            )
        config = next(path for path in paths if path.suffix == ".json5")
        typer.echo(f"Try it: {this_command()} check --zenoh-config {config}")


@app.command(epilog="Example: hexapod-gateway certs renew gateway --dir ~/hexapod-certs")
def renew(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help='A laptop, a console, a robot; "gateway" is the first robot.')
    ],
    directory: Directory = DEFAULT_FOLDER,
    host: Hosts = [],  # noqa: B006 (read only)
    days: Days = certs.LEAF_DAYS,
) -> None:
    """Extend a certificate before it expires, or give a robot a further --host. Its key and its old hosts stay."""
    path = certs.folder.renew(directory, name, hosts=host, days=days)
    made = certs.folder.describe(path)
    is_robot = made.role == certs.authority.GATEWAY
    where = "" if is_robot else f": copy it over the old one on {name}'s machine"
    typer.echo(f"{path} is valid until {made.not_after:%Y-%m-%d}{where}.")
    if is_robot:
        _echo_installation(certs.folder.hosts_of(path)[0], path.parent)
    if host and is_robot:
        typer.echo(f"Laptops issued before reach that address with --connect tls/{host[0]}:PORT --zenoh-config …")


@app.command("list", epilog="Example: hexapod-gateway certs list --dir ~/hexapod-certs")
def show(directory: Directory = DEFAULT_FOLDER, as_json: JsonOption = False) -> None:
    """List all certificates: name, role, expiry, days left, serial number, common name, and state.

    The state is good, expired or revoked. Tab-separated if not on a terminal.
    """
    from rich.console import Console
    from rich.table import Table

    now = dt.datetime.now(dt.UTC)
    head = ("NAME", "ROLE", "EXPIRES", "DAYS LEFT", "SERIAL", "COMMON NAME", "STATE")
    found = [(each, each.days_left(now), state) for each, state in certs.folder.states(directory, now)]
    rows = [
        (each.name, each.role, f"{each.not_after:%Y-%m-%d}", str(left), each.serial, each.common_name, state)
        for each, left, state in found
    ]
    console = Console()
    if as_json:
        names = [title.lower().replace(" ", "_") for title in head]
        typer.echo(json.dumps([dict(zip(names, row, strict=True)) for row in rows]))
        return
    if not console.is_terminal:
        for row in (head, *rows):
            typer.echo("\t".join(row))
        return
    table = Table(padding=(0, 0) if console.width < WIDE else (0, 1))
    for title in head:
        table.add_column(title.capitalize(), overflow="fold", no_wrap=title != "SERIAL")
    for row, (_, left, state) in zip(rows, found, strict=True):
        table.add_row(*row, style="red" if state != "good" else "yellow" if left < expiry.WARN_DAYS else None)
    console.print(table)


@app.command(epilog="Example: hexapod-gateway certs revoke alice --dir ~/hexapod-certs")
def revoke(
    directory: Directory = DEFAULT_FOLDER,
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME]",
            help="The laptop, or a common name such as operator-07. Without one, the robots get the present list.",
        ),
    ] = None,
    to: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROBOT", help="Only to this robot: its name, a host or an endpoint; repeat it. Default: to all."
        ),
    ] = None,
    zenoh_config: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="Whose connection it is. Default: an operator's in the folder."),
    ] = None,
) -> None:
    """Shut a laptop out: it is lost, stolen, or no longer anybody's.

    Signs a list (revoked.crl, an X.509 CRL) and sends it to each robot, a line each. A robot that gets it stops all
    legs, starts anew within three seconds, and from then on the laptop gets nothing. The laptop's files are deleted
    here. To undo it, `certs issue` the name anew.

    A robot that is off gets it later, by the same command without the name, or by a copy of revoked.crl in
    /etc/hexapod-gateway/zenoh and a restart of the service.
    """
    from gateway.people.commands import revoking

    raise typer.Exit(revoking.revoke(directory, name, to or [], zenoh_config))
