"""A folder of certificates: `init` once, `issue` for each laptop, `expiries` lists them.

Everything is made in memory, then written together (files.py), so that no incomplete set remains.
"""

import datetime as dt
import io
import json
import os
import re
import stat
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import zenoh
from cryptography import x509
from cryptography.hazmat.primitives import serialization

from gateway import nesting
from gateway.certs import (
    CONSOLE_DAYS,
    LAPTOP_ROLES,
    LEAF_DAYS,
    authority,
    fleet_files,
    pool,
    revocation,
    zenoh_files,
)
from gateway.certs.authority import KeyPair, is_issued
from gateway.certs.files import (
    SECRET_MODE,
    FileContent,
    publish,
    read_certificate,
    read_certificates,
    read_file,
    read_key,
    replace,
)
from gateway.errors import ConfigError

# Letters, digits, - and _: a valid file name on every system, and never a path out of the folder.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,62}")
_RESERVED = ("ca", "gateway", "router")
_ROBOT = "robot."  # in front of a robot's name in the common name of its certificate
_ROBOT_LENGTH = 48  # a common name has at most 64 characters, "operator-1000." among them
_GROUP_LENGTH = 50
_WEB_CA = "-ca"  # behind a console's name in the names of its CA's files
ROUTER_FILE = "router.json5"
EARLIER = "earlier"
"""Folder of replaced files, whose certificates may still be valid."""


@dataclass(frozen=True)
class Certificate:
    """One certificate of a folder. `role`: ca, gateway, operator, observer or button; in a fleet with the robot's name,
    such as robot.NAME or operator.NAME. The common name also has a laptop's number.
    """

    path: Path
    name: str
    role: str
    common_name: str
    serial: str
    not_before: dt.datetime
    not_after: dt.datetime

    def days_left(self, now: dt.datetime) -> int:
        """Whole days until it expires; negative once it has."""
        return (self.not_after - now) // dt.timedelta(days=1)


def init(
    directory: Path,
    hosts: Sequence[str],
    *,
    days: int = LEAF_DAYS,
    port: int = zenoh_files.DEFAULT_PORT,
    namespace: str = "",
    size: int = pool.SIZE,
    now: dt.datetime | None = None,
) -> list[Path]:
    """Make a CA, the gateway's certificate for `hosts` and gateway.json5 in `directory`; returns the paths.

    `namespace` precedes all keys of this robot. `size`: laptops of each role that the rules list in advance.
    `directory` is made (0700) if missing. Raises ConfigError if it has a CA, or a file of the same name.
    """
    now = now or now_utc()
    names = _dialled_hosts(hosts)
    if not names:
        raise ConfigError(
            "name at least one host by which laptops reach the robot: --host robot.local --host 192.0.2.7"
        )
    if namespace and not _NAME.fullmatch(namespace):
        raise ConfigError(f"{namespace!r} cannot be a namespace: use letters, digits, - and _ (up to 63)")
    if os.path.lexists(directory / "ca.key") or os.path.lexists(directory / "ca.pem"):
        raise ConfigError(
            f"{directory} has a CA already, and a new one would lock out all laptops: "
            "`certs issue` adds a laptop to it; for a new CA give another --dir"
        )
    ca = authority.make_ca(now)
    gateway = authority.make_gateway(ca, names, days, now)
    files = {
        **_pair(directory / authority.CA, ca),  # first: its key decides which of two simultaneous inits fails
        **_pair(directory / authority.GATEWAY, gateway),
        directory / "gateway.json5": FileContent(zenoh_files.gateway_json5(names, port, namespace, size)),
    }
    publish(files)
    return list(files)


def issue(
    directory: Path,
    name: str,
    role: str,
    *,
    robots: Sequence[str] = (),
    bundle: Path | None = None,
    days: int = LEAF_DAYS,
    now: dt.datetime | None = None,
    absolute: bool = False,
) -> list[Path]:
    """Make NAME.pem, NAME.key and NAME.json5 for a laptop, and `bundle`, a zip of all it needs; returns the paths.

    `robots`: of a fleet, by the names of `add_robots`; `pool.ALL` alone: all. For several there is a NAME.ROBOT.json5
    for each. router.json5 is rewritten, and returned, if it does not list the common name. `absolute`: NAME.json5 has
    absolute paths; in the zip, never.
    """
    now = now or now_utc()
    _check_name(name)
    if role not in LAPTOP_ROLES:
        raise ConfigError(
            f"unknown role {role!r}: choose operator (commands and watches), observer (only watches) or button (stops "
            "and watches, and moves nothing)"
        )
    ca = load_ca(directory, now)
    gateway = read_certificate(directory / "gateway.pem")
    hosts, (port, namespace) = authority.hosts_of(gateway), _port_and_namespace(directory / "gateway.json5")
    group, known = pool.group(robots), robots_of(directory)
    for robot in robots:
        if robot not in (*known, pool.ALL):
            raise ConfigError(f"{directory} has no robot {robot!r}: add it with `hexapod-gateway certs robot {robot}`")
    if group == pool.ALL and not known:
        raise ConfigError(f"{directory} has no robots: add them with `hexapod-gateway certs robot NAME`")
    if len(group) > _GROUP_LENGTH:
        raise ConfigError("the robots' names are too long together for one certificate: for all robots, or for fewer")
    _check_free(directory, name)
    common_name = _free_common_name(directory, ca, role, group)
    laptop = authority.make_laptop(ca, name, common_name, days, now)
    pair = _pair(directory / name, laptop)
    configs = {
        config: FileContent(zenoh_files.laptop_json5(name, role, hosts, port, robot or namespace, config.name))
        for robot, config in config_files(directory, name, pool.holder(common_name)).items()
    }
    files = {**pair, **configs}
    if bundle is not None:
        if bundle in files:
            raise ConfigError(f"--bundle {bundle} is the place of another file: name it {name}.zip")
        expiry = f"{laptop.certificate.not_valid_after_utc:%Y-%m-%d}"
        members = {path.name: content for path, content in files.items()}
        members["ca.pem"] = FileContent(read_file(directory / "ca.pem", "certificate"))
        readme = zenoh_files.laptop_readme(name, role, hosts, expiry, [config.name for config in configs])
        members["README.txt"] = FileContent(readme)
        files[bundle] = FileContent(_zip(members, now), SECRET_MODE)
    for config in configs if absolute else ():
        text = files[config].data
        for file in (directory / "ca.pem", *pair):
            text = text.replace(f'"{file.name}"'.encode(), json.dumps(str(file.absolute())).encode())
        files[config] = FileContent(text)
    publish(files)
    if group and common_name not in listed_names(directory / ROUTER_FILE):
        return [*files, write_router(directory)]
    return list(files)


def config_files(directory: Path, name: str, holder: pool.Holder) -> dict[str, Path]:
    """A laptop's Zenoh configuration for each of its robots: NAME.json5 for one, else NAME.ROBOT.json5."""
    robots = robots_of(directory) if holder.robot == pool.ALL else holder.robots
    if holder.robot != pool.ALL and len(robots) < 2:
        return {holder.robot: directory / f"{name}.json5"}
    return {robot: directory / f"{name}.{robot}.json5" for robot in robots}


def console(
    directory: Path, name: str, hosts: Sequence[str], *, days: int = CONSOLE_DAYS, now: dt.datetime | None = None
) -> list[Path]:
    """Make NAME.pem and NAME.key for a web console that browsers reach by `hosts`, and its own CA; returns the paths.

    People import NAME-ca.pem into a browser: unlike ca.pem, it is valid for these hosts only.
    """
    now = now or now_utc()
    _check_name(name)
    names = list(dict.fromkeys(authority.parse_host(host) for host in hosts))
    if not names:
        raise ConfigError("name at least one host by which browsers reach the console: --host robot.local")
    load_ca(directory, now)
    _check_free(directory, name)
    ca = authority.make_web_ca(names, now)
    made = authority.make_console(ca, name, names, days, now)
    files = _pair(directory / name, made) | _pair(directory / f"{name}{_WEB_CA}", ca)
    publish(files)
    return list(files)


def add_robots(
    directory: Path, names: Sequence[str], *, days: int = LEAF_DAYS, now: dt.datetime | None = None
) -> list[Path]:
    """Make NAME.pem, NAME.key and NAME.json5 for each robot of a fleet, and rewrite router.json5; returns the paths.

    People with a certificate for all robots get a configuration for each new one. The router's certificate is the one
    of `init`: its hosts are the router's, and robots dial the first.
    """
    now = now or now_utc()
    ca = load_ca(directory, now)
    gateway = read_certificate(directory / "gateway.pem")
    hosts, port = authority.hosts_of(gateway), port_of(directory)
    _check_free(directory, "router")
    files: dict[Path, FileContent] = {}
    for name in names:
        _check_name(name)
        if len(name) > _ROBOT_LENGTH:
            raise ConfigError(f"{name!r} is too long for a robot's name: use at most {_ROBOT_LENGTH} characters")
        _check_free(directory, name)
        robot = authority.make_laptop(ca, name, f"{_ROBOT}{name}", days, now)
        files |= _pair(directory / name, robot)
        files[directory / f"{name}.json5"] = FileContent(fleet_files.robot_json5(name, hosts[0], port))
        for each in expiries(directory):
            person, holder = each.path.stem, pool.holder(each.common_name)
            if holder.robot == pool.ALL:
                config = directory / f"{person}.{name}.json5"
                files[config] = FileContent(
                    zenoh_files.laptop_json5(person, holder.role, hosts, port, name, config.name)
                )
    publish(files)
    return [*files, write_router(directory)]


def write_router(directory: Path) -> Path:
    """Rewrite router.json5 with all robots of the folder and its pool, without revoked names; returns its path."""
    path, config = directory / ROUTER_FILE, directory / "gateway.json5"
    port, listed = _port_and_namespace(config)[0], listed_names(config)
    numbers = sorted({number for name in listed if (number := pool.holder(name).number) is not None})
    known = revoked(directory)
    shut_out = frozenset() if known is None else known.common_names
    holders = [pool.holder(each.common_name) for each in (*expiries(directory), *earlier(directory))]
    groups = {each.robot for each in holders if len(each.robots) > 1}
    replace(path, FileContent(fleet_files.router_json5(robots_of(directory), port, numbers, shut_out, groups)))
    return path


def renew(
    directory: Path, name: str, *, hosts: Sequence[str] = (), days: int = LEAF_DAYS, now: dt.datetime | None = None
) -> Path:
    """Renew the certificate of a laptop, or "gateway", with the same key; returns its path.

    `hosts`: further names and addresses of the robot, or a console.
    """
    now = now or now_utc()
    if name != authority.GATEWAY:
        _check_name(name)
    own = f"{name}{_WEB_CA}" if (directory / f"{name}{_WEB_CA}.key").exists() else authority.CA
    ca, path = load_ca(directory, now, own), directory / f"{name}.pem"
    old = read_certificate(path)
    _check_renewable(directory, path, old, ca, own)
    known = authority.hosts_of(old)
    if hosts and not known:
        raise ConfigError(f"{path} is a laptop's, and nobody dials it: --host is for the gateway, or a console")
    further = [host for host in _dialled_hosts(hosts) if host not in known]
    if not authority.permits(ca.certificate, further):
        raise ConfigError(
            f"{own}.pem, which browsers have imported, is good for {', '.join(known)} only: make another with "
            f"`hexapod-gateway certs console NAME --host …`, and import NAME{_WEB_CA}.pem"
        )
    renewed = authority.renew(ca, old, days, now, [*known, *further]).public_bytes(serialization.Encoding.PEM)
    replace(path, FileContent(renewed))
    return path


def _dialled_hosts(hosts: Sequence[str]) -> list[str]:
    """The hosts in normal form, each once. Raises ConfigError for an IPv6 address."""
    names = list(dict.fromkeys(authority.parse_host(host) for host in hosts))
    for name in names:
        if ":" in name:  # an IPv6 address: parse_host lets no port through
            raise ConfigError(
                f"Zenoh dials no IPv6 address over TLS, so no laptop could reach {name}: give a name that stands for "
                "it, such as robot.local, or an IPv4 address"
            )
    return names


def expiries(directory: Path) -> list[Certificate]:
    """All certificates (*.pem) of a folder, the CA first, then the gateway's, then by name; ConfigError if none.

    A robot's and a laptop's folder have only their own.
    """
    try:
        paths = sorted(path for path in directory.iterdir() if path.suffix == ".pem" and not path.name.startswith("."))
    except OSError as error:
        raise ConfigError(
            f"cannot read {directory}: {error.strerror}; give the folder that `certs init` made"
        ) from error
    if not paths:
        raise ConfigError(f"{directory} has no certificates (*.pem): make them with `hexapod-gateway certs init`")
    order = (authority.CA, authority.GATEWAY)
    found = [describe(path) for path in paths]
    return sorted(found, key=lambda item: (order.index(item.role) if item.role in order else len(order), item.name))


def describe(path: Path) -> Certificate:
    """The certificate in the PEM file at `path`. Raises ConfigError."""
    certificate = read_certificate(path)
    common_name, name = authority.common_name_and_name(certificate)
    return Certificate(
        path,
        name,
        pool.holder(common_name).of,
        common_name,
        f"{certificate.serial_number:x}",
        certificate.not_valid_before_utc,
        certificate.not_valid_after_utc,
    )


def earlier(directory: Path) -> list[Certificate]:
    """The laptops' replaced certificates, also revoked ones."""
    found = sorted((directory / EARLIER).glob("*.pem"))
    return [certificate for path in found if (certificate := describe(path)).role != authority.CA]


def revoked(directory: Path) -> revocation.RevocationList | None:
    """The list of revoked certificates in this folder; None: there is none."""
    path = directory / revocation.REVOCATION_FILE
    return revocation.read(path, read_certificates(directory / "ca.pem")) if path.exists() else None


def listed_names(config: Path) -> set[str]:
    """The common names in the rules of a gateway.json5."""
    subjects = json.loads(_read_config(config).get_json("access_control/subjects")) or []
    return {name for each in subjects for name in each.get("cert_common_names") or []}


def port_of(directory: Path) -> int:
    """The port that the robot of this folder listens on."""
    return _port_and_namespace(directory / "gateway.json5")[0]


def _free_common_name(directory: Path, ca: KeyPair, role: str, group: str) -> str:
    """The first unused common name of the pool; the role alone if the rules list no pool."""
    config = directory / "gateway.json5"
    listed = [pool.holder(name) for name in listed_names(config)]
    if listed and role not in {each.role for each in listed}:
        anew = zenoh_files.command_for_new_rules(str(config), *_port_and_namespace(config))
        raise ConfigError(
            f"{config} was made before there was the role {role}, and lets nobody in as one: make it anew, here and on "
            f"the robot: {anew}"
        )
    numbers = sorted(each.number for each in listed if each.role == role and each.number is not None)
    if not numbers:
        return pool.names(role, (), group)[0]
    known = revoked(directory)
    taken = {each.common_name for each in (*expiries(directory), *earlier(directory))}
    taken |= frozenset() if known is None else known.common_names
    first = authority.first_number(ca.certificate)
    free = (name for n in numbers if n >= first and (name := pool.common_name(role, n, group)) not in taken)
    found = next(free, None)
    if found is None:
        raise ConfigError(
            f"all common names of {role} that the rules list are taken; more: hexapod-gateway certs pool --size "
            f"{numbers[-1] + 1 + pool.SIZE} --dir {directory}, and the same on the robot, in its folder"
        )
    return found


def _check_renewable(directory: Path, path: Path, old: x509.Certificate, ca: KeyPair, own: str) -> None:
    """Raises ConfigError for a certificate that is revoked or of another CA."""
    common_name = authority.common_name_and_name(old)[0]
    known = revoked(directory)
    if known is not None and known.holds(common_name, old.serial_number):
        raise ConfigError(f"{path} is revoked; `hexapod-gateway certs issue` makes another")
    issuers = [ca.certificate] if own != authority.CA else read_certificates(directory / "ca.pem")
    issuer = next((each for each in issuers if is_issued(old, each)), None)
    if issuer is None:
        raise ConfigError(f"{path} was not issued by the CA in {directory}: issue a new one there")
    if issuer != ca.certificate and pool.holder(common_name).role in LAPTOP_ROLES:
        raise ConfigError(
            f"{path} is of the older CA: `hexapod-gateway certs reissue {path.stem}` makes one of the new"
        )


def load_ca(directory: Path, now: dt.datetime, name: str = authority.CA) -> KeyPair:
    """The folder's newest CA with its key. Raises ConfigError if it is missing or has expired."""
    try:
        (directory / f"{name}.key").lstat()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise ConfigError(
            f"{directory} has no ca.key: give the folder that `hexapod-gateway certs init` made, with --dir"
        ) from error
    except OSError:
        pass  # read_key reports it
    key = read_key(directory / f"{name}.key")
    found = read_certificates(directory / f"{name}.pem")
    # Of several CAs, the one of this key: while one replaces another, the new certificate comes first.
    certificate = next((each for each in found if each.public_key() == key.public_key()), None)
    if certificate is None:
        raise ConfigError(
            f"{directory}: {name}.key and {name}.pem do not belong together; restore both from the same copy"
        )
    if certificate.not_valid_after_utc <= now:
        raise ConfigError(
            f"the CA in {directory} expired on {certificate.not_valid_after_utc:%Y-%m-%d}: make a new one with "
            "`hexapod-gateway certs init` in another folder, and issue all certificates again"
        )
    return KeyPair(certificate, key)


def _port_and_namespace(config: Path) -> tuple[int, str]:
    """Both from gateway.json5, so that a laptop's file follows manual changes there."""
    read = _read_config(config)
    found = re.search(r'"tls/[^"]*:(\d+)', read.get_json("listen/endpoints"))
    if found is None:
        raise ConfigError(
            f"{config} listens on no tls endpoint with a port: fix listen.endpoints, such as tls/[::]:7447"
        )
    return int(found[1]), json.loads(read.get_json("namespace")) or ""


def _read_config(config: Path) -> zenoh.Config:
    try:
        nesting.check(read_file(config, "Zenoh configuration"))
        return zenoh.Config.from_file(str(config))
    except (ValueError, zenoh.ZError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"cannot read {config}: {reason}; restore it, or fix what it names") from error


def robots(directory: Path) -> list[str]:
    """All robots of a folder: those of a fleet, or the single one, by its first host."""
    return robots_of(directory) or authority.hosts_of(read_certificate(directory / "gateway.pem"))[:1]


def robots_of(directory: Path) -> list[str]:
    """The robots of a fleet, sorted; none in the folder of a single robot."""
    roles = [item.role for item in expiries(directory)]
    return sorted(role.removeprefix(_ROBOT) for role in roles if role.startswith(_ROBOT))


def _check_free(directory: Path, name: str) -> None:
    suffixes = (".pem", ".key", ".json5") if name != "router" else (".pem", ".key")  # its file is rewritten
    taken = next((path for suffix in suffixes if os.path.lexists(path := directory / f"{name}{suffix}")), None)
    if taken is not None:
        raise ConfigError(f"the name {name} is taken ({taken} exists, and is never overwritten): choose another")


def _pair(stem: Path, pair: KeyPair) -> dict[Path, FileContent]:
    """The two files of a pair: the key (0600) and the certificate."""
    return {
        stem.with_name(f"{stem.name}.key"): FileContent(pair.key_pem(), SECRET_MODE),
        stem.with_name(f"{stem.name}.pem"): FileContent(pair.certificate_pem()),
    }


def _zip(members: dict[str, FileContent], now: dt.datetime) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            entry = zipfile.ZipInfo(name, (now.year, now.month, now.day, now.hour, now.minute, now.second))
            entry.create_system = 3  # Unix: `unzip` then restores the mode, and the key stays 0600
            entry.external_attr = (stat.S_IFREG | content.mode) << 16
            archive.writestr(entry, content.data, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name) or name.lower() in _RESERVED:
        raise ConfigError(
            f"{name!r} cannot name a laptop: use letters, digits, - and _ (up to 63, a letter or digit first), "
            f"and not {', '.join(_RESERVED)}"
        )


def now_utc() -> dt.datetime:
    return dt.datetime.now(dt.UTC)
