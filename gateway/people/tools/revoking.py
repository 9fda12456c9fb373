"""Brings a list of revoked certificates to robots: signed where the CA is, taken by the service, or by root."""

import os
import subprocess
from pathlib import Path
from typing import Final

from gateway.certs import folder, moving, pool, zenoh_files
from gateway.certs.files import read_certificates, read_file
from gateway.certs.revocation import RevocationList, parse, why_not_newer
from gateway.errors import ConfigError, GatewayError, RejectedError, ZenohError
from gateway.people.client.blocking import Client
from gateway.people.terminal import hint, say, this_command
from gateway.robot import settings as settings_file
from gateway.robot.edge import revoked
from gateway.robot.edge.session import service_config
from schemas.revocation import MAX_REVOCATION_BYTES, RevocationAck

UNIT: Final = "hexapod-gateway"
ANSWER_S: Final = 5.0


def revoke(directory: Path, name: str | None, to: list[str], zenoh_config: Path | None, *, others_too: bool) -> int:
    """Sign a newer list that shuts `name` out, and bring it to these hosts; the exit code."""
    if name is None and not to:
        raise ConfigError("say whom to shut out, or to which robot the list goes (--to): see --help")
    if name is not None:
        found = moving.revoke(directory, name, others_too=others_too)
        say(f"{directory / 'revoked.crl'}: list {found.number} shuts out {', '.join(sorted(found.common_names))}.")
        if (directory / folder.ROUTER_FILE).exists():
            say(f"The router has to know, too: copy {directory / folder.ROUTER_FILE} to it, and restart it.")
    elif folder.revoked(directory) is None:
        raise ConfigError(f"{directory} has no list yet: nobody was revoked")
    if not to:
        say(f"Bring it to the robot: {this_command()} certs revoke --dir {directory} --to HOST")
        say("or copy the file, and there: sudo hexapod-gateway revoke revoked.crl")
        return 0
    config = zenoh_config or _operators_file(directory)
    codes = [_bring(directory, host, config) for host in to]
    return max(codes)


def _bring(directory: Path, host: str, config: Path) -> int:
    """To one robot. What another copy of the folder has revoked there is kept."""
    endpoint = host if "/" in host else zenoh_files.endpoint(host, folder.port_of(directory))
    try:
        with Client(endpoint, zenoh_config=config, source=f"{UNIT} certs revoke", timeout_s=ANSWER_S) as client:
            ack = _send(client, directory)
    except RejectedError as error:
        hint(f"{host}: {error}")
        return error.exit_code
    except ZenohError as error:
        for line in str(error).splitlines():
            hint(f"{host}: {line}")
        hint(f"Once it is there: {this_command()} certs revoke --dir {directory} --to {host}")
        return error.exit_code
    say(f"{host}: list {ack.number} is in force.")
    return 0


def _send(client: Client, directory: Path) -> RevocationAck:
    cas, there = read_certificates(directory / "ca.pem"), client.revocation()
    known_there = None if there.revoked is None else parse(there.revoked.encode(), cas)
    found = folder.revoked(directory)
    if known_there is not None and (found is None or found.pem != known_there.pem):
        missing = known_there.common_names - (frozenset() if found is None else found.common_names)
        if missing or (found is not None and found.number <= known_there.number):
            found = moving.merge(directory, known_there)
            hint(f"The robot had list {known_there.number}; list {found.number} has both.")
    if found is None:
        raise ConfigError(f"{directory} has no list yet: nobody was revoked")
    if len(found.pem) > MAX_REVOCATION_BYTES - 100:
        raise ConfigError("the list is too long for a message: copy revoked.crl, and: sudo hexapod-gateway revoke FILE")
    ack = client.revocation(found.pem.decode())
    if not ack.accepted:
        raise RejectedError(str(ack.reason), ack.detail or "")
    return ack


def _operators_file(directory: Path) -> Path:
    """The Zenoh file of an operator of the folder who is not shut out."""
    known = folder.revoked(directory)
    for each in folder.expiries(directory):
        config = each.path.with_suffix(".json5")
        if pool.holder(each.common_name).role != "operator" or not config.exists():
            continue
        if known is None or not known.holds(each.common_name, int(each.serial, 16)):
            hint(f"As {each.name} ({config}).")
            return config
    raise ConfigError(f"{directory} has no files of an operator: name your own with --zenoh-config NAME.json5")


def take(file: Path, config: Path | None) -> int:
    """On the robot: put the list in `file` in force, and restart the service. Returns the exit code."""
    data = read_file(file, "list of revoked certificates")
    settings = settings_file.load(config, simulated=True).zenoh
    kept = revoked.kept(service_config(settings), settings, started_by_systemd=False)
    if kept is None:
        raise ConfigError("this robot's Zenoh file names no CA, so it knows nobody by a certificate")
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
