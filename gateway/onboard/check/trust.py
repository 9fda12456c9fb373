"""Whether the robot's certificate, key, authority and list of revoked certificates belong together."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import zenoh
from cryptography import x509

from gateway import certs
from gateway.certs import revocation
from gateway.errors import ConfigError
from gateway.onboard.check.installation import RESTART, SERVICE
from gateway.onboard.check.result import Result, failure, warning
from gateway.robot.sections import ZenohSettings
from gateway.zenoh_config import get, load_config

LET_READ: Final = (
    "let the service read it, and nobody else: sudo chown -R root:hexapod-gateway /etc/hexapod-gateway; "
    f"sudo chmod -R u=rwX,g=rX,o= /etc/hexapod-gateway; {RESTART}"
)
_TLS: Final = "transport/link/tls"
_CA: Final = f"{_TLS}/root_ca_certificate"


def results(settings: ZenohSettings, *, state: Path | None) -> list[Result]:
    """What does not belong together; nothing where no certificates are in use, or one cannot be read."""
    if not settings.config:
        return []
    try:
        config = load_config(Path(settings.config))
        cas = certs.files.read_certificates(Path(_named(config, _CA))) if _named(config, _CA) else []
        return [*_pairs(config, cas), *_lists(Path(settings.config).absolute().parent, state, cas)] if cas else []
    except ConfigError:  # another row reports it
        return []


def _named(config: zenoh.Config, setting: str) -> str:
    found = get(config, setting)
    return found if isinstance(found, str) else ""


def _pairs(config: zenoh.Config, cas: list[x509.Certificate]) -> Iterator[Result]:
    """Of what the robot listens with, and of what it dials a router with: mostly the same files."""
    sides = (
        (_named(config, f"{_TLS}/{side}_certificate"), _named(config, f"{_TLS}/{side}_private_key"))
        for side in ("listen", "connect")
    )
    ca = _named(config, _CA)
    for certificate, key in dict.fromkeys(sides):
        if not certificate or not key:
            continue
        found = certs.files.read_certificate(Path(certificate))
        fix = _of_one_folder(Path(ca), Path(certificate), Path(key))
        if not any(certs.authority.is_issued(found, each) for each in cas):
            yield failure("certificates", f"{certificate} is of another authority than {ca}: nobody can connect", fix)
        if certs.files.read_key(Path(key)).public_key() != found.public_key():
            yield failure("certificates", f"{key} is not the key of {certificate}: nobody can connect", fix)


def _of_one_folder(*files: Path) -> str:
    names = ",".join(file.name for file in files)
    return (
        f"copy these from one folder of certificates (where ca.key is) to FOLDER here, then: "
        f"sudo cp FOLDER/{{{names}}} {files[0].parent} && {LET_READ.partition(': ')[2]}"
    )


def _lists(beside: Path, state: Path | None, cas: list[x509.Certificate]) -> Iterator[Result]:
    """Each list that the service reads at its start: its own, and one that came with the certificates."""
    for path in (each / revocation.REVOCATION_FILE for each in (state, beside) if each is not None):
        fix = (
            f"copy {revocation.REVOCATION_FILE} from the folder of certificates (where ca.key is) to FILE here, then: "
            f"sudo install -m 644 -o {SERVICE} -g {SERVICE} FILE {path} && {RESTART}"
        )
        try:
            revocation.read(path, cas)
        except revocation.ForeignListError:
            yield warning("revoked", f"{path} is of another authority, so nobody is shut out by it", fix)
        except ConfigError as error:
            yield failure("revoked", f"{error}; the service does not start", fix)
        except PermissionError:  # the row of the state directory reports it
            continue
