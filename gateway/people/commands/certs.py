"""`hexapod-gateway certs`: arguments in, one call of gateway.certs, and a few lines that state what to do next."""

import json
from pathlib import Path
from typing import Annotated, Final, Literal

import typer

from gateway import certs
from gateway.certs import access
from gateway.errors import ConfigError, GatewayError
from gateway.people.commands.options import JsonOption
from gateway.people.terminal import hint, say
from gateway.words.own_command import this_command

app = typer.Typer(
    no_args_is_help=True,
    help="Make and revoke certificates: who may reach the robot over the network, and in which role.\n\n"
    "Keep the folder on a machine you trust, not on the robot: anyone with its ca.key can admit anyone.",
)
DEFAULT_FOLDER: Final = Path("~/hexapod-certs")
Directory = Annotated[Path, typer.Option("--dir", metavar="D", callback=Path.expanduser, help="The CA's folder.")]
Days = Annotated[int, typer.Option(metavar="N", min=1, max=certs.CA_DAYS, help="Days until it expires, or its CA.")]
Hosts = Annotated[list[str], typer.Option(metavar="HOST", help="Name or address of robot or console; repeatable.")]


@app.command(epilog="Example: hexapod-gateway certs init --dir ~/hexapod-certs --host robot.local --host 192.0.2.7")
def init(
    host: Hosts,
    port: Annotated[int, typer.Option(metavar="N", min=1, max=65535, help="The port the robot listens on.")] = 7447,
    directory: Directory = DEFAULT_FOLDER,
    days: Days = certs.LEAF_DAYS,
) -> None:
    """Make a private CA, the robot's certificate, and a Zenoh configuration that admits only certificates of this CA.

    Laptops reach the robot only by one of its --host. No file is overwritten: a folder that has a CA is an error.
    """
    certs.folder.init(directory, host, days=days, port=port)
    say(f"Made a CA and the robot's files in {directory}. Leave ca.key here, and keep a copy somewhere safe.")
    _say_installation(host[0], directory)
    next_step = f"certs issue NAME --role operator --dir {directory} --bundle NAME.zip"
    say(f"Next, for each laptop: {this_command()} {next_step}")


def _say_installation(host: str, directory: Path, bundle: Path | None = None) -> None:
    """How a robot gets its files: the zip, or those of its folder without ca.key."""
    say("The robot's files, and how its service gets them:")
    files = " ".join(str(directory / name) for name in certs.folder.ROBOT_FILES)
    made = f"  ssh {host} mkdir -p -m 700 robot-certs\n  scp {files} {host}:robot-certs/"
    typer.echo(f"  scp {bundle} {host}:" if bundle else made)
    say(f"and on the robot: sudo hexapod-gateway setup --certs {bundle.name if bundle else 'robot-certs'}")


@app.command(epilog="Example: hexapod-gateway certs issue alice --role operator --dir ~/hexapod-certs")
def issue(
    name: Annotated[str, typer.Argument(metavar="NAME", help="The laptop or its owner: letters, digits, - and _.")],
    role: Annotated[
        Literal["operator", "observer", "button", "robot", "console"],
        typer.Option(help="An operator commands and watches, an observer watches, a button stops and watches."),
    ],
    directory: Directory = DEFAULT_FOLDER,
    host: Hosts = [],  # noqa: B006 (read only)
    bundle: Annotated[Path | None, typer.Option(metavar="ZIP", help="Also put all into this zip, the key too.")] = None,
    days: Days = certs.LEAF_DAYS,
) -> None:
    """Make the files of a laptop, of a further robot, or of a web console. Nothing changes on any robot.

    A laptop reaches all robots of this CA: NAME.json5 leads to the first, NAME.ROBOT.json5 to another. A console's
    certificate is valid for 459 days at most. Browsers trust it after NAME-ca.pem is imported as an authority.
    """
    paths = certs.folder.issue(directory, name, role, hosts=host, bundle=bundle, days=days)
    files = " ".join(path.name for path in paths if path != bundle)
    say(f"Made {name}, {role}, in {paths[0].parent}: {files}")
    if role == certs.folder.ROBOT:
        _say_installation(host[0], directory / name, bundle)
        say(f"Laptops issued before reach it with --connect tls/{host[0]}:PORT --zenoh-config …")
    elif role == certs.authority.CONSOLE:
        say(f"Copy {name}.pem and {name}.key to the machine of the console, and there:")
        command = f"hexapod-gateway console --listen 0.0.0.0:8443 --cert {name}.pem --key {name}.key"
        say(f"  {command} --zenoh-config PERSON.json5")
        say(f"In each browser, import {directory / f'{name}-ca.pem'} as an authority, once.")
    else:
        if bundle is not None:
            say(f"All that the laptop needs is in {bundle}, its key too: hand it over in private, then delete it.")
        config = next(path for path in paths if path.suffix == ".json5")
        say(f"Try it: {this_command()} check --zenoh-config {config}")


@app.command(epilog="Example: hexapod-gateway certs renew gateway --dir ~/hexapod-certs")
def renew(
    name: Annotated[str, typer.Argument(metavar="NAME", help='A laptop, console or robot; "gateway" is the first.')],
    directory: Directory = DEFAULT_FOLDER,
    host: Hosts = [],  # noqa: B006 (read only)
    days: Days = certs.LEAF_DAYS,
) -> None:
    """Extend a certificate before it expires, or give a robot a further --host. Its key and its old hosts stay."""
    made = certs.folder.renew(directory, name, hosts=host, days=days)
    is_robot = made.role == certs.authority.GATEWAY
    where = "" if is_robot else f": copy it over the old one on {name}'s machine"
    say(f"{made.path} is valid until {made.not_after:%Y-%m-%d}{where}.")
    if is_robot:
        _say_installation(made.hosts[0], made.path.parent)
    if host:
        say(f"Laptops issued before reach that address with --connect tls/{host[0]}:PORT --zenoh-config …")


@app.command("list", epilog="Example: hexapod-gateway certs list --dir ~/hexapod-certs")
def show(directory: Directory = DEFAULT_FOLDER, as_json: JsonOption = False) -> None:
    """List all certificates, a line each: name, role, expiry, common name, and state (good, expired or revoked)."""
    names, found = ("name", "role", "expires", "common_name", "state"), certs.folder.states(directory)
    rows = [(each.name, each.role, f"{each.not_after:%Y-%m-%d}", each.common_name, state) for each, state in found]
    if as_json:
        typer.echo(json.dumps([dict(zip(names, row, strict=True)) for row in rows]))
        return
    for row in [("NAME", "ROLE", "EXPIRES", "COMMON NAME", "STATE"), *rows]:
        say("{:27}  {:8}  {:10}  {:13}  {}".format(*row))


@app.command(epilog="Example: hexapod-gateway certs revoke alice --dir ~/hexapod-certs")
def revoke(
    directory: Directory = DEFAULT_FOLDER,
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="The laptop, or its common name.")] = None,
    to: Annotated[list[str] | None, typer.Option(metavar="ROBOT", help="Only to this name, host or endpoint.")] = None,
    zenoh_config: Annotated[Path | None, typer.Option(metavar="PATH", help="Instead of another operator's.")] = None,
) -> None:
    """Shut out a laptop that is lost, stolen or no longer used.

    It signs a list (revoked.crl, an X.509 CRL) and sends the list to each robot. The robot stops all legs, restarts
    its service within three seconds, and no longer admits the laptop. The laptop's files are deleted here. To undo
    it, issue the name again. If a robot is off, repeat the command later without the name.
    """
    config, robots = zenoh_config or _operators_file(directory, but=name), _endpoints(directory, to)
    known = certs.folder.revoked(directory) if name is None else certs.folder.revoke(directory, name)
    if known is None:
        say(f"{directory} has no list: nobody was revoked.")
        return
    file, missing = certs.revocation.REVOCATION_FILE, []
    say(f"{directory / file}: list {known.number} shuts out {', '.join(sorted(known.common_names))}.")
    for robot, endpoints in robots.items():
        try:
            say(f"{robot}: list {_send(directory, endpoints, config)} is in force.")
        except GatewayError as error:
            missing.append(robot)
            hint(f"{robot}: {str(error).splitlines()[0]}")
    if missing:
        hint(f"Not confirmed by {', '.join(missing)}. Later: {this_command()} certs revoke --dir {directory}")
        hint(f"or copy {file} to /etc/hexapod-gateway/zenoh/ there: sudo systemctl restart hexapod-gateway")
        raise typer.Exit(1)


def _endpoints(directory: Path, to: list[str] | None) -> dict[str, list[str]]:
    """How to reach each robot: `to` has names of the folder, hosts or endpoints; without it, all of the folder."""
    robots, port = certs.folder.robots_of(directory), certs.folder.port_of(directory / "gateway.json5")
    others = {each: [each if "/" in each else access.endpoint(each, port)] for each in to or ()}
    return {each: certs.folder.endpoints_of(robots[each]) if each in robots else others[each] for each in to or robots}


def _send(directory: Path, endpoints: list[str], config: Path) -> int:
    """Return the number of the list that this robot now has in force, by the first endpoint that it answers on.

    Raises GatewayError.
    """
    from gateway.people.client.blocking import Client  # slow to load, which --help need not wait for

    endpoint, *others = endpoints
    try:
        with Client(endpoint, zenoh_config=config, source="hexapod-gateway certs", timeout_s=5.0) as client:
            client.state()  # a robot that is starting is awaited
            newest = certs.folder.newest(directory, client.revocation().revoked)
            client.revocation(newest.pem.decode()).or_raise()
    except GatewayError:
        if not others:
            raise
        return _send(directory, others, config)
    return newest.number


def _operators_file(directory: Path, but: str | None) -> Path:
    """Return the Zenoh file of an operator of the folder whose certificate is valid, and who is not to be shut out."""
    for each, state in certs.folder.states(directory):
        config = directory / f"{each.path.stem}.json5"
        usable = each.role == certs.OPERATOR and state == "good" and but not in (each.name, each.common_name)
        if usable and config.exists():
            return config
    raise ConfigError(f"{directory} has no files of another operator: issue one, or use --zenoh-config NAME.json5")
