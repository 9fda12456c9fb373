"""Signs a list of revoked certificates where the CA is, and sends it to the robots."""

from pathlib import Path
from typing import Final

from gateway.certs import OPERATOR, folder, zenoh_files
from gateway.certs.authority import hosts_of
from gateway.certs.files import read_certificate, read_certificates
from gateway.certs.revocation import REVOCATION_FILE, RevocationList, parse
from gateway.errors import ConfigError, GatewayError, RejectedError
from gateway.own_command import this_command
from gateway.people.client.blocking import Client
from gateway.people.terminal import hint, say
from schemas.revocation import MAX_REVOCATION_BYTES

ANSWER_S: Final = 5.0


def revoke(directory: Path, name: str | None, to: list[str], zenoh_config: Path | None) -> int:
    """Sign a list that shuts `name` out, and send it to `to`, or to all robots of the folder. Return the exit code.

    Without a name, the list is sent as it is. Raises ConfigError.
    """
    config, robots = zenoh_config or _operators_file(directory, but=name), _endpoints(directory, to)
    known = folder.revoked(directory) if name is None else folder.revoke(directory, name)
    if known is None:
        say(f"{directory} has no list: nobody was revoked.")
        return 0
    shut_out = ", ".join(sorted(known.common_names))
    say(f"{directory / REVOCATION_FILE}: list {known.number} shuts out {shut_out}.")
    missing = []
    for robot, endpoints in robots.items():
        faults = []
        for endpoint in endpoints:
            try:
                say(f"{robot}: list {_send(directory, endpoint, config)} is in force.")
                break
            except GatewayError as error:
                faults.append(str(error).splitlines()[0])
        else:
            missing.append(robot)
            hint(f"{robot}: {'; '.join(faults)}")
    if missing:
        hint(f"Not confirmed by {', '.join(missing)}. Later: {this_command()} certs revoke --dir {directory}")
        hint(f"or copy {REVOCATION_FILE} to /etc/hexapod-gateway/zenoh/ there: sudo systemctl restart hexapod-gateway")
    return 1 if missing else 0


def _endpoints(directory: Path, to: list[str]) -> dict[str, list[str]]:
    """How to reach each robot: `to` has names of the folder, hosts or endpoints; without it, all of the folder."""
    robots = folder.robots_of(directory)
    found: dict[str, list[str]] = {}
    for each in to or robots:
        if "/" in each:
            found[each] = [each]
            continue
        home = robots.get(each)
        hosts = [each] if home is None else hosts_of(read_certificate(home / "gateway.pem"))
        port = folder.port_of((home or directory) / "gateway.json5")
        found[each] = [zenoh_files.endpoint(host, port) for host in hosts]
    return found


def _send(directory: Path, endpoint: str, config: Path) -> int:
    """Return the number of the list that this robot now has in force. Raises GatewayError."""
    with Client(endpoint, zenoh_config=config, source="hexapod-gateway certs revoke", timeout_s=ANSWER_S) as client:
        client.state()  # a robot that is starting is awaited
        newest = _newest(directory, client.revocation().revoked)
        if len(newest.pem) > MAX_REVOCATION_BYTES - 100:
            raise ConfigError(f"the list is too long for a message: copy {REVOCATION_FILE} to the robot")
        ack = client.revocation(newest.pem.decode())
    if not ack.accepted:
        raise RejectedError(str(ack.reason), ack.detail or "")
    return newest.number


def _newest(directory: Path, there: str | None) -> RevocationList:
    """The folder's list. It takes in what only the robot's list has, after a backup of the folder was restored."""
    known = folder.revoked(directory)
    if known is None:
        raise ConfigError(f"{directory} has no list: nobody was revoked")
    if there is None or there == known.pem.decode():
        return known
    theirs = parse(there.encode(), read_certificates(directory / "ca.pem"))
    if theirs.number < known.number and theirs.common_names <= known.common_names:
        return known
    return folder.adopt(directory, theirs)


def _operators_file(directory: Path, but: str | None) -> Path:
    """The Zenoh file of an operator of the folder whose certificate is valid, and who is not to be shut out."""
    for each, state in folder.states(directory, folder.now_utc()):
        config = directory / f"{each.path.stem}.json5"
        if each.role == OPERATOR and state == "good" and but not in (each.name, each.common_name) and config.exists():
            return config
    raise ConfigError(
        f"{directory} has no files of another operator: issue one, or name your own: --zenoh-config NAME.json5"
    )
