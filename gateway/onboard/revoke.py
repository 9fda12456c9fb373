"""`revoke`, on the robot: puts a list of revoked certificates in force that somebody has brought as a file."""

import os
import subprocess
from pathlib import Path

from gateway.certs.files import read_file
from gateway.certs.revocation import RevocationList, parse, why_not_newer
from gateway.errors import ConfigError, GatewayError
from gateway.onboard.check.installation import SERVICE
from gateway.people.terminal import hint, say
from gateway.robot import settings as settings_file
from gateway.robot.zenoh_io import revoked
from gateway.robot.zenoh_io.session import service_config


def take(file: Path, config: Path | None) -> int:
    """On the robot: put the list in `file` in force, and restart the service. Returns the exit code."""
    data = read_file(file, "list of revoked certificates")
    settings = settings_file.load(config, simulated=True).zenoh
    kept = revoked.revocation_state(service_config(settings), settings, started_by_systemd=False)
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
    if not _systemd() or subprocess.run(["systemctl", "is-active", "--quiet", SERVICE], check=False).returncode != 0:
        say("It takes effect when the gateway starts.")
        return 0
    if subprocess.run(["systemctl", "restart", SERVICE], check=False).returncode != 0:
        hint(f"The list is kept, but the service does not restart: see journalctl -u {SERVICE}.")
        return 1
    say(f"The service was restarted, all legs stopped; list {found.number} is in force.")
    return 0


def _systemd() -> bool:
    return Path("/run/systemd/system").is_dir() and os.geteuid() == 0
