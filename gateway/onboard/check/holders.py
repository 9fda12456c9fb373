"""Who is shut out: at the robot, and as a laptop sees it."""

import datetime as dt
from collections.abc import Iterator
from typing import Final

import zenoh

from gateway import certs
from gateway.errors import ConfigError
from gateway.onboard.check.result import Result, failure, ok, warning
from gateway.own_command import this_command
from gateway.people.client.requests import Identity
from gateway.robot.settings import Settings
from gateway.robot.zenoh_io import revoked
from schemas.telemetry import RevocationsReport

_LIST: Final = "revoked"
_BRING: Final = "where ca.key is: hexapod-gateway certs revoke --dir DIR brings the newest list"


def shut_out_at_the_robot(config: zenoh.Config, settings: Settings) -> Iterator[Result]:
    """The list in force; nothing where the Zenoh file names no CA."""
    try:
        kept = revoked.revocation_state(config, settings, started_by_systemd=False)
    except ConfigError as error:
        yield failure(_LIST, str(error), _BRING)
        return
    if kept is None:
        return
    if kept.known is None:
        yield ok(_LIST, f"there is no list: nobody is shut out. If somebody was, {_BRING}")
        return
    yield ok(_LIST, f"{_of(kept.known.number, kept.known.date)} shuts out {len(kept.known.entries)}")


def shut_out_from_the_laptop(there: RevocationsReport | None, identity: Identity) -> Iterator[Result]:
    """The list in force at the robot, and whether it is older than that in the laptop's own folder."""
    if identity.ca is None:
        return
    said = "the robot names no list of revoked certificates"
    if there is not None:
        said = f"the robot goes by {_of(there.number, there.date)}"
    folder = identity.ca.parent
    try:
        own = certs.folder.revoked(folder)
    except ConfigError as error:
        yield warning(_LIST, str(error), "restore it from a copy of the folder")
        return
    if own is not None and own.number > (0 if there is None else there.number):
        fix = f"{this_command()} certs revoke --dir {folder}"
        yield warning(_LIST, f"{said}; {folder} has {_of(own.number, own.date)}", fix)
    else:
        yield ok(_LIST, said)


def _of(number: int, date: dt.datetime) -> str:
    return f"list {number} of {date:%Y-%m-%d}"
