"""Brings a list of revoked certificates to robots: signed where the CA is, taken by the service, or by root."""

import os
import subprocess
from pathlib import Path
from typing import Final, NamedTuple

from gateway.certs import OPERATOR, confirmed, folder, moving, pool, zenoh_files
from gateway.certs.files import read_certificates, read_file
from gateway.certs.revocation import REVOCATION_FILE, RevocationList, parse, why_not_newer
from gateway.errors import ConfigError, GatewayError, RejectedError
from gateway.people.client.blocking import Client
from gateway.people.terminal import hint, say, this_command
from gateway.robot import settings as settings_file
from gateway.robot.zenoh_io import revoked
from gateway.robot.zenoh_io.session import service_config
from schemas.revocation import MAX_REVOCATION_BYTES

UNIT: Final = "hexapod-gateway"
ANSWER_S: Final = 5.0


def revoke(directory: Path, name: str | None, to: list[str], zenoh_config: Path | None, *, others_too: bool) -> int:
    """Sign a newer list that shuts `name` out, and bring it to all robots of the folder, or to these; the exit code."""
    ways = _ways(directory, to, zenoh_config)
    if name is not None:
        found = moving.revoke(directory, name, others_too=others_too)
        say(f"{directory / REVOCATION_FILE}: list {found.number} shuts out {', '.join(sorted(found.common_names))}.")
    elif folder.revoked(directory) is None:
        say(f"{directory} has no list: nobody was revoked.")
        return 0
    missing = _bring(directory, ways)
    if (directory / folder.ROUTER_FILE).exists():
        say(f"The router has to know, too: copy {directory / folder.ROUTER_FILE} to it, and restart it.")
    if missing:
        later = f"{this_command()} certs revoke --dir {directory}"
        hint(f"Not confirmed by {', '.join(missing)}. Once they are there: {later}")
        hint(f"or copy the file, and there: sudo hexapod-gateway revoke {REVOCATION_FILE}")
    return 1 if missing else 0


class _Way(NamedTuple):
    """How to reach a robot; None: as an operator's file in the folder does."""

    robot: str
    endpoint: str | None = None
    config: Path | None = None


def _ways(directory: Path, to: list[str], config: Path | None) -> list[_Way]:
    """`to`: robots of a fleet by name; hosts or endpoints of a single one. Raises ConfigError."""
    known, fleet = folder.robots(directory), folder.robots_of(directory)
    if not fleet:
        port = folder.port_of(directory)
        endpoints = [host if "/" in host else zenoh_files.endpoint(host, port) for host in to]
        return [_Way(known[0], endpoint, config) for endpoint in endpoints or (None,)]
    unknown = [robot for robot in to if robot not in fleet]
    if unknown:
        raise ConfigError(
            f"{directory} has no robot {', '.join(unknown)}; in a fleet, --to is one of {', '.join(fleet)}"
        )
    if config is not None and len(to) != 1:
        raise ConfigError("--zenoh-config leads to one robot: name it with --to")
    return [_Way(robot, None, config) for robot in to or fleet]


def _bring(directory: Path, ways: list[_Way]) -> list[str]:
    """One after the other; the robots that have not confirmed the folder's list.

    A robot may have a list of another copy of the folder. Then the folder's becomes a newer one with both, and those
    that have confirmed the one before get it in a second round.
    """
    in_force: dict[_Way, int] = {}
    silent: set[_Way] = set()
    for _ in range(2):
        for way in ways:
            if way in silent or in_force.get(way) == _number(directory):
                continue
            try:
                in_force[way] = _bring_to(directory, way)
            except GatewayError as error:
                silent.add(way)
                for line in str(error).splitlines():
                    hint(f"{way.robot}: {line}")
    return list(dict.fromkeys(way.robot for way in ways if in_force.get(way) != _number(directory)))


def _bring_to(directory: Path, way: _Way) -> int:
    """Its number, once it is in force there and the folder has noted so."""
    config, person = (way.config, way.config.stem) if way.config else _operators_file(directory, way.robot)
    with Client(way.endpoint, zenoh_config=config, source=f"{UNIT} certs revoke", timeout_s=ANSWER_S) as client:
        client.state()  # a robot that starts anew is awaited
        number = _send(client, directory, way.robot)
    confirmed.note(directory, way.robot, number)
    say(f"{way.robot}: list {number} is in force (brought as {person}).")
    return number


def _send(client: Client, directory: Path, robot: str) -> int:
    found = folder.revoked(directory)
    if found is None:
        raise ConfigError(f"{directory} has no list yet: nobody was revoked")
    cas, there = read_certificates(directory / "ca.pem"), client.revocation()
    known_there = None if there.revoked is None else parse(there.revoked.encode(), cas)
    before, number = confirmed.numbers(directory).get(robot, 0), 0 if known_there is None else known_there.number
    if number < before:
        hint(f"{robot} had list {before}, and has {f'list {number}' if number else 'none'} now: was a backup restored?")
    if (known_there is not None and found.pem != known_there.pem) and (
        known_there.common_names - found.common_names or found.number <= known_there.number
    ):
        found = moving.merge(directory, known_there)
        hint(f"{robot} had list {known_there.number}; list {found.number} has both.")
    if len(found.pem) > MAX_REVOCATION_BYTES - 100:
        raise ConfigError(
            f"the list is too long for a message: copy {REVOCATION_FILE}, and: sudo hexapod-gateway revoke FILE"
        )
    ack = client.revocation(found.pem.decode())
    if not ack.accepted:
        raise RejectedError(str(ack.reason), ack.detail or "")
    return found.number


def _number(directory: Path) -> int:
    found = folder.revoked(directory)
    return 0 if found is None else found.number


def _operators_file(directory: Path, robot: str) -> tuple[Path, str]:
    """The Zenoh file for this robot of an operator of the folder who is not shut out, and who that is."""
    known, fleet, now = folder.revoked(directory), folder.robots_of(directory), folder.now_utc()
    for each in folder.expiries(directory):
        holder = pool.holder(each.common_name)
        shut_out = known is not None and known.holds(each.common_name, int(each.serial, 16))
        if holder.role == OPERATOR and holder.is_for(robot if fleet else "") and not shut_out and each.not_after > now:
            config = folder.config_files(directory, each.path.stem, holder)[robot if fleet else ""]
            if config.exists():
                return config, each.name
    raise ConfigError(
        f"{directory} has no files of an operator of it: issue one, or name your own: --zenoh-config NAME.json5"
        + (f" --to {robot}" if fleet else "")
    )


def take(file: Path, config: Path | None) -> int:
    """On the robot: put the list in `file` in force, and restart the service. Returns the exit code."""
    data = read_file(file, "list of revoked certificates")
    settings = settings_file.load(config, simulated=True).zenoh
    kept = revoked.revocation_state(service_config(settings), settings, started_by_systemd=False)
    if kept is None:
        raise ConfigError("this robot's Zenoh file names no CA, so there are no certificates to revoke")
    try:
        found = parse(data, kept.cas)
    except ConfigError as error:
        raise ConfigError(f"{file}: {error}") from error
    if kept.known is not None and kept.known.pem == found.pem:
        say(f"List {found.number} is in force already.")
        return 0
    fault = why_not_newer(found, kept.known)
    if fault is not None:
        raise GatewayError(f"{file}: {fault}")
    revoked.keep(kept.path, found)
    say(f"{kept.path}: list {found.number} shuts out {', '.join(sorted(found.common_names))}.")
    return _restart(found)


def _restart(found: RevocationList) -> int:
    """As root, where the service runs under systemd; else somebody has to."""
    if not _systemd() or subprocess.run(["systemctl", "is-active", "--quiet", UNIT], check=False).returncode != 0:
        say("It takes effect when the gateway starts.")
        return 0
    if subprocess.run(["systemctl", "restart", UNIT], check=False).returncode != 0:
        hint(f"The list is kept, but the service does not restart: journalctl -u {UNIT} says why.")
        return 1
    say(f"The service was restarted, all legs stopped; list {found.number} is in force.")
    return 0


def _systemd() -> bool:
    return Path("/run/systemd/system").is_dir() and os.geteuid() == 0
