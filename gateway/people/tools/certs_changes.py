"""`hexapod-gateway certs revoke`, `reissue`, `pool`, `replace-ca` and `drop-ca`: what changes over the years."""

from pathlib import Path
from typing import Annotated

import typer

from gateway import certs
from gateway.certs import pool
from gateway.people.terminal import this_command
from gateway.people.tools.certs import Days, Directory, app

__all__ = ["app"]

OthersToo = Annotated[bool, typer.Option("--others-too", help="Also where others are concerned, whom it then names.")]
Name = Annotated[
    str,
    typer.Argument(metavar="NAME", help="The laptop, as `certs list` names it. Example: alice", show_default=False),
]


@app.command(epilog="Example: hexapod-gateway certs revoke alice --dir ~/hexapod-certs --to robot.local")
def revoke(
    directory: Directory,
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME]",
            help="The laptop, and all certificates it ever had; or one common name, such as operator-07. Without it, "
            "the list as it is goes to --to",
            show_default=False,
        ),
    ] = None,
    to: Annotated[
        list[str] | None,
        typer.Option(
            metavar="HOST",
            help="Bring the list to this robot now, over an operator's connection; repeat it for each robot. "
            "Example: --to robot.local, or an endpoint: --to tls/192.0.2.7:7447",
            show_default=False,
        ),
    ] = None,
    zenoh_config: Annotated[
        Path | None,
        typer.Option(
            "--zenoh-config",
            metavar="PATH",
            help="Whose connection it is. Default: that of an operator in the folder who is not shut out.",
        ),
    ] = None,
    others_too: OthersToo = False,
) -> None:
    """Shut a laptop out: it is lost, stolen, or no longer anybody's.

    Signs a list (revoked.crl, an X.509 CRL) whose number only grows. A robot that gets it stops all legs, starts anew
    within three seconds, and from then on the laptop gets nothing: Zenoh drops what it sends, its proofs for the lease
    are rejected. Nobody else has to do anything. To undo it, `certs issue` the name anew.

    A robot that is off gets it later: `certs revoke --to robot.local`, or the file: `sudo hexapod-gateway revoke FILE`
    there.

    Exit codes: 0 done, 1 a robot rejects the list, 2 an argument or the folder is wrong, 4 a robot does not answer; the
    list is signed then, and can be brought later.
    """
    from gateway.people.tools import revoking

    raise typer.Exit(revoking.revoke(directory, name, to or [], zenoh_config, others_too=others_too))


@app.command(epilog="Example: hexapod-gateway certs reissue alice --dir ~/hexapod-certs --bundle alice.zip")
def reissue(
    name: Name,
    directory: Directory,
    bundle: Annotated[
        Path | None,
        typer.Option(
            metavar="ZIP",
            help="Also put all that the laptop needs into this zip, its key included. Example: --bundle alice.zip",
            show_default=False,
        ),
    ] = None,
    days: Days = certs.LEAF_DAYS,
) -> None:
    """Give a laptop another certificate: new key, a common name of its own, signed by the newest CA.

    For laptops of the layout before (common name `operator`), which cannot be revoked one by one, and for another CA.
    What it has now goes on working until it expires or is revoked; its files move to the folder `earlier`.
    """
    paths = certs.reissue(directory, name, bundle=bundle, days=days)
    made = certs.describe(directory / f"{name}.pem")
    typer.echo(f"{name} is {made.common_name} now: {' '.join(path.name for path in paths)} in {directory}.")
    typer.echo(f"Bring them to {name}'s machine, in place of the old ones; these still work.")
    typer.echo(f"Once they are gone: {this_command()} certs list --dir {directory} names what can be revoked.")


@app.command("pool", epilog="Example: sudo hexapod-gateway certs pool --dir /etc/hexapod-gateway/zenoh")
def set_pool(
    directory: Directory,
    size: Annotated[int, typer.Option(metavar="N", help="How many laptops of each role. Example: --size 128")] = (
        pool.SIZE
    ),
) -> None:
    """Let the rules in gateway.json5 know so many common names of each role, so that each laptop can have its own.

    Once for a folder of the layout before, where all operators share one, and again when the pool is used up. In the
    folder with the CA, and in that on the robot; what else is written in the file stays.
    """
    for path in certs.set_pool(directory, size):
        typer.echo(f"{path} lists at least {size} common names of each role.")
    typer.echo(
        "If this is the robot: sudo systemctl restart hexapod-gateway (all legs stop). A router: restart it, too."
    )


@app.command("replace-ca", epilog="Example: hexapod-gateway certs replace-ca --dir ~/hexapod-certs")
def replace_ca(directory: Directory) -> None:
    """Make a new CA beside the old one; both are good until `drop-ca`. Laptops move over one by one (`reissue`)."""
    paths = certs.replace_ca(directory)
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
    path = certs.drop_ca(directory, others_too=others_too)
    typer.echo(f"{path} has the new CA only: bring it to the robot, and restart the service.")
