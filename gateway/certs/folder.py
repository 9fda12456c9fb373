"""A folder of certificates: `init` once, `issue` for each laptop, robot and console, `revoke` for a lost one.

A command's files are made in memory, then written together (files.py), so that no incomplete set remains.
"""

import datetime as dt
import io
import os
import re
import stat
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

import zenoh
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from gateway.certs import LAPTOP_ROLES, LEAF_DAYS, access, authority, files, first_fault, how_to_renew, revocation
from gateway.certs.authority import CA, CONSOLE, GATEWAY, Certificate, KeyPair, is_issued
from gateway.certs.files import read_certificate
from gateway.certs.revocation import RevocationList, Revoked
from gateway.errors import ConfigError
from gateway.files import durable, nesting

ROBOT: Final = "robot"
ROBOT_FILES: Final = ("gateway.pem", "gateway.key", "ca.pem", "gateway.json5")
"""The files that a robot needs."""

# Letters, digits, - and _: a valid file name on every system, and never a path out of the folder.
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,62}")
_WEB_CA: Final = "-ca"  # follows a console's name in the names of its CA's files
_NO_SERIAL: Final = 1
"""Stands for a revoked laptop without files. Our serial numbers are random, so no certificate has this one."""


def init(directory: Path, hosts: Sequence[str], *, days: int = LEAF_DAYS, port: int = 7447) -> None:
    """Make a CA, the gateway's certificate for `hosts` and gateway.json5 in `directory`.

    `directory` is made (0700) if missing. Raises ConfigError if it has a CA, or a file of the same name.
    """
    if any(os.path.lexists(directory / name) for name in ("ca.key", "ca.pem")):
        raise ConfigError(f"{directory} has a CA already, to which `certs issue` adds; a new one needs another --dir")
    ca = authority.make_ca(now_utc())
    # The CA first: its key decides which of two simultaneous inits fails.
    files.publish(ca.files(directory / CA) | _robot(directory, ca, hosts, port, days))


def issue(
    directory: Path,
    name: str,
    role: str,
    *,
    hosts: Sequence[str] = (),
    bundle: Path | None = None,
    days: int = LEAF_DAYS,
) -> list[Path]:
    """Make the files of a laptop, a further robot or a web console; return the paths. Raises ConfigError.

    A laptop gets a Zenoh file for each robot, and a robot a folder; the zip `bundle` has all that either needs. A
    console gets a CA of its own, valid only for the `hosts` by which browsers reach it.
    """
    _check_name(name)
    ca, laptop, now = load_ca(directory), role in LAPTOP_ROLES, now_utc()
    taken = any(os.path.lexists(directory / f"{name}{suffix}") for suffix in ("", ".pem", ".key", ".json5"))
    if fault := first_fault(
        (taken, f"the name {name} is taken in {directory}, and no file is overwritten: choose another"),
        (hosts and laptop, "nobody dials a laptop: --host is for a robot or a console"),
        (not (hosts or laptop), f"name at least one host by which the {role} is reached: --host {name}.local"),
        (bundle and role == CONSOLE, f"--bundle is for a laptop or a robot; {name} is a {role}"),
    ):
        raise ConfigError(fault)
    if role == ROBOT:
        made = _robot(directory / name, ca, hosts, port_of(directory / "gateway.json5"), days)
        made[directory / name / "ca.pem"] = ca.certificate_pem()
    elif role == CONSOLE:
        parsed = authority.parse_hosts(hosts)
        own = authority.make_ca(now, parsed)
        web = authority.make_leaf(own, CONSOLE, name, parsed, days, now)
        made = web.files(directory / name) | own.files(directory / f"{name}{_WEB_CA}")
    else:
        listed = {each.common_name for each, _ in states(directory)}
        common_name = next((each for each in access.every(role) if each not in listed), None)
        if common_name is None:
            raise ConfigError(f"all {access.MOST} common names of {role} are taken: make a new CA in another folder")
        made = authority.make_leaf(ca, common_name, name, (), days, now).files(directory / name)
        for robot, folder in robots_of(directory).items():
            config = directory / (f"{name}.json5" if robot == GATEWAY else f"{name}.{robot}.json5")
            made[config] = access.laptop_json5(name, role, endpoints_of(folder), config.name)
    if bundle in made or (bundle is not None and bundle.suffix in files.PUBLIC):
        raise ConfigError(f"--bundle {bundle} is the place of another file: name it NAME.zip")
    if bundle is not None:
        made[bundle] = _zip({"ca.pem": ca.certificate_pem()} | {path.name: each for path, each in made.items()})
    files.publish(made)
    return list(made)


def _robot(directory: Path, ca: KeyPair, hosts: Sequence[str], port: int, days: int) -> dict[Path, bytes]:
    dialled = _dialled_hosts(hosts)
    made = authority.make_leaf(ca, GATEWAY, GATEWAY, dialled, days, now_utc())
    return made.files(directory / GATEWAY) | {directory / "gateway.json5": access.gateway_json5(dialled, port)}


def renew(directory: Path, name: str, *, hosts: Sequence[str] = (), days: int = LEAF_DAYS) -> Certificate:
    """Renew the certificate of a laptop, a robot ("gateway" for the first) or a console, with the same key.

    Return it. `hosts`: further names and addresses of a robot. Raises ConfigError.
    """
    robots, own = robots_of(directory), f"{name}{_WEB_CA}"
    if name != GATEWAY:
        _check_name(name)
    ca = load_ca(directory, own if (directory / f"{own}.key").exists() else CA)
    path = robots[name] / "gateway.pem" if name in robots else directory / f"{name}.pem"
    old, known = read_certificate(path), revoked(directory)
    before = authority.describe(old, path)
    if fault := first_fault(
        (known and known.holds(before.common_name, before.serial), "is revoked; `certs issue` makes another"),
        (not is_issued(old, ca.certificate), f"was not issued by the CA in {directory}: issue a new one there"),
        (hosts and before.role != GATEWAY, "keeps its own hosts: `certs issue` makes one for others"),
    ):
        raise ConfigError(f"{path} {fault}")
    reached = list(dict.fromkeys([*before.hosts, *(_dialled_hosts(hosts) if hosts else ())]))
    renewed = authority.sign(ca, old.subject, old.public_key(), reached, days, now_utc())
    files.replace(path, renewed.public_bytes(serialization.Encoding.PEM))
    return describe(path)


@contextmanager
def _alone(directory: Path) -> Iterator[None]:
    """Context for a change of the list: two at once would each sign a list without the other's entry."""
    try:
        with durable.locked(directory / revocation.REVOCATION_FILE):
            yield
    except OSError as error:
        raise ConfigError(f"cannot write in {directory}: {error.strerror}; give the folder of `certs init`") from error


def revoke(directory: Path, name: str) -> RevocationList:
    """Revoke a laptop, by its name or its common name (`operator-07`); return the new list.

    The laptop's files are deleted, so that its name can be issued again. Raises ConfigError.
    """
    with _alone(directory):
        known = revoked(directory)
        before = known.entries if known else ()
        laptops = (each for each in expiries(directory) if each.role in LAPTOP_ROLES)
        found = next((each for each in laptops if name in (each.name, each.common_name)), None)
        if not found and any(name in (entry.name, entry.common_name) for entry in before):
            raise ConfigError(f"{name} is revoked already")
        if not found and access.role_of(name) == name:
            raise ConfigError(f"there is no laptop {name!r}: `hexapod-gateway certs list --dir {directory}` names them")
        entry = (found.common_name, found.name, found.serial) if found else (name, "", _NO_SERIAL)
        made = _sign(directory, known, (*before, Revoked(*entry, now_utc())))
        for path in directory.glob(f"{found.path.stem}.*") if found else ():
            if path.suffix in (".pem", ".key", ".json5"):
                path.unlink()
        return made


def newest(directory: Path, there: str | None) -> RevocationList:
    """Return the folder's list for a robot that has the list `there` (PEM). Raises ConfigError if there is none.

    If the robot's list has an entry that the folder's lacks, as after a restored backup, sign a list with both.
    """
    known = revoked(directory)
    if known is None:
        raise ConfigError(f"{directory} has no list: nobody was revoked")
    theirs = revocation.parse(there.encode(), [read_certificate(directory / "ca.pem")]) if there else known
    if theirs == known or (theirs.number < known.number and theirs.common_names <= known.common_names):
        return known
    with _alone(directory):
        known = revoked(directory) or known
        entries = {entry.common_name: entry for entry in (*theirs.entries, *known.entries)}
        return _sign(directory, max(theirs, known, key=lambda each: each.number), entries.values())


def _sign(directory: Path, before: RevocationList | None, entries: Iterable[Revoked]) -> RevocationList:
    made = revocation.sign(load_ca(directory), before.number + 1 if before else 1, entries, now_utc())
    files.replace(directory / revocation.REVOCATION_FILE, made.pem)
    return made


def revoked(directory: Path) -> RevocationList | None:
    """Return the list of revoked certificates in this folder; None: there is none. Raises ConfigError."""
    path = directory / revocation.REVOCATION_FILE
    return revocation.read(path, [read_certificate(directory / "ca.pem")]) if path.exists() else None


def states(directory: Path) -> list[tuple[Certificate, str]]:
    """Return all certificates with their states: good, expired, revoked. Needs no CA key. Raises ConfigError."""
    known, found, now = revoked(directory), expiries(directory), now_utc()
    listed = {each.common_name for each in found}
    for each in known.entries if known else ():
        if each.common_name not in listed:  # without a file its expiry is unknown
            role, since = access.role_of(each.common_name), each.since
            found.append(Certificate(each.name, role, each.common_name, each.serial, since, since))
    gone = {each for each in found if known and known.holds(each.common_name, each.serial)}
    return [(each, "revoked" if each in gone else "expired" if each.not_after <= now else "good") for each in found]


def expiries(directory: Path) -> list[Certificate]:
    """Return all certificates (*.pem) of a folder: the CA's, then the robots', then by name. Raises ConfigError."""
    try:
        paths = [path for path in directory.iterdir() if path.suffix == ".pem" and not path.name.startswith(".")]
    except OSError as error:
        raise ConfigError(f"cannot read {directory}: {error.strerror}; give the folder of `certs init`") from error
    if not paths:
        raise ConfigError(f"{directory} has no certificates (*.pem): make them with `hexapod-gateway certs init`")
    paths += [folder / "gateway.pem" for robot, folder in robots_of(directory).items() if robot != GATEWAY]
    order = {CA: 0, GATEWAY: 1}
    return sorted(map(describe, paths), key=lambda item: (order.get(item.role, 2), item.name, item.path))


def describe(path: Path) -> Certificate:
    """Return the certificate in the PEM file at `path`. Raises ConfigError."""
    return authority.describe(read_certificate(path), path)


def endpoints_of(robot: Path) -> list[str]:
    """Return the Zenoh endpoints of the robot with this folder. Raises ConfigError."""
    port = port_of(robot / "gateway.json5")
    return [access.endpoint(host, port) for host in describe(robot / "gateway.pem").hosts]


def robots_of(directory: Path) -> dict[str, Path]:
    """Return each robot's folder by its name; the first one, whose files `init` made, is called "gateway"."""
    own = {GATEWAY: directory} if (directory / "gateway.pem").exists() else {}
    return own | {path.parent.name: path.parent for path in sorted(directory.glob("*/gateway.pem"))}


def port_of(config: Path) -> int:
    """Return the port in a robot's gateway.json5, where a person may have changed it. Raises ConfigError."""
    try:
        nesting.check(files.read_file(config, "Zenoh configuration"))
        endpoints = zenoh.Config.from_file(str(config)).get_json("listen/endpoints")
    except (ValueError, zenoh.ZError) as error:
        raise ConfigError(f"cannot read {config}: {str(error).splitlines()[0]}; restore it, or fix that") from error
    if (found := re.search(r'"tls/[^"]*:(\d+)', endpoints)) is None:
        raise ConfigError(f"{config} listens on no tls endpoint with a port: fix listen.endpoints (tls/[::]:7447)")
    return int(found[1])


def mismatch(ca: Path, certificate: Path, key: Path, *, of_robot: bool = True) -> str:
    """Return why these files do not belong together, or are no robot's; "": they are right. Raises ConfigError."""
    own, name = read_certificate(certificate), certificate.name
    role, issued = authority.describe(own).role, any(is_issued(own, each) for each in files.read_certificates(ca))
    fault = first_fault(
        (not issued, f"{name} is of another authority than {ca.name}"),
        (files.read_key(key).public_key() != own.public_key(), f"{key.name} is not the key of {name}"),
        (of_robot and role != GATEWAY, f"{name} is of {role}, not of a robot"),
    )
    return f"in {certificate.parent}, {fault}" if fault else ""


def contradiction(ca: Path, certificate: Path, key: Path) -> str:
    """Return why a TLS server cannot use these files; "": it may. An authority of another name may have signed by one
    between, and a key of another kind is not judged. Raises ConfigError."""
    own, name = read_certificate(certificate), certificate.name
    namesakes = [each for each in files.read_certificates(ca) if each.subject == own.issuer]
    with suppress(ConfigError):
        if files.read_key(key).public_key() != own.public_key():
            return f"in {certificate.parent}, {key.name} is not the key of {name}"
    if namesakes and not any(is_issued(own, each) for each in namesakes):
        return f"in {certificate.parent}, {name} is of another authority than {ca.name}, which has the same name"
    return ""


def load_ca(directory: Path, name: str = CA) -> KeyPair:
    """Return the folder's CA with its key. Raises ConfigError if it is missing or has expired."""
    key, certificate = files.read_key(directory / f"{name}.key"), read_certificate(directory / f"{name}.pem")
    end = certificate.not_valid_after_utc
    if not isinstance(key, ec.EllipticCurvePrivateKey) or certificate.public_key() != key.public_key():
        raise ConfigError(f"{directory}: {name}.key and {name}.pem do not belong together; restore both from one copy")
    if end <= now_utc():
        raise ConfigError(f"the CA in {directory} expired on {end:%Y-%m-%d}; {how_to_renew('', CA, '')}")
    return KeyPair(certificate, key)


def now_utc() -> dt.datetime:
    return dt.datetime.now(dt.UTC)


def _dialled_hosts(hosts: Sequence[str]) -> list[str]:
    """Return the hosts in normal form, each once. Raises ConfigError without one, or for an IPv6 address."""
    found = authority.parse_hosts(hosts)
    if not found:
        raise ConfigError("name at least one host by which laptops reach the robot: --host robot.local")
    if of_ipv6 := [name for name in found if ":" in name]:  # parse_host lets no port through
        fix = "give a name that stands for it, such as robot.local, or an IPv4 address"
        raise ConfigError(f"Zenoh dials no IPv6 address over TLS, so no laptop could reach {of_ipv6[0]}: {fix}")
    return found


def _zip(members: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in members.items():
            entry = zipfile.ZipInfo(name, now_utc().timetuple()[:6])
            entry.external_attr = (stat.S_IFREG | files.mode_of(Path(name))) << 16  # `unzip` then keeps the key 0600
            archive.writestr(entry, content)
    return buffer.getvalue()


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name) or name.lower() in (CA, GATEWAY):
        rule = "letters, digits, - and _ (up to 63, a letter or digit first), not ca or gateway"
        raise ConfigError(f"{name!r} cannot be a name here: use {rule}")
