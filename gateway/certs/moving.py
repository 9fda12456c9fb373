"""Changes of a folder of certificates over the years: revoking, reissuing, a larger pool, another CA.

No file is deleted: replaced files go to the folder `earlier`.
"""

import datetime as dt
import re
from collections.abc import Iterable
from pathlib import Path

from gateway.certs import LAPTOP_ROLES, LEAF_DAYS, access, authority, folder, pool, revocation
from gateway.certs.files import SECRET_MODE, FileContent, read_certificate, read_certificates, read_file, replace
from gateway.certs.folder import EARLIER, ROUTER_FILE, Certificate
from gateway.certs.revocation import RevocationList, Revoked
from gateway.errors import ConfigError

_LISTED = re.compile(r"cert_common_names:\s*(\[[^\]]*\])")
_QUOTED = re.compile(r'"([^"]*)"')


def revoke(
    directory: Path,
    name: str,
    *,
    others_too: bool = False,
    known_there: RevocationList | None = None,
    now: dt.datetime | None = None,
) -> RevocationList:
    """Revoke all certificates of a laptop, or the one with the common name `name`; returns the new list.

    `known_there`: the list that a robot has, possibly of another copy of this folder; its entries are kept. The
    laptop's files go to `earlier`, so that its name can be issued again. `others_too`: also if others share the common
    name, as in the old layout.
    """
    now = now or folder.now_utc()
    ca, known = folder.load_ca(directory, now), folder.revoked(directory)
    before = _entries(known, known_there)
    present = [each for each in folder.expiries(directory) if _is_laptop(each)]
    everyone = [*present, *folder.earlier(directory)]
    chosen = [each for each in everyone if name in (each.path.stem, each.name, each.common_name)]
    fresh = [each for each in chosen if each.common_name not in before]
    if not fresh:
        if chosen or name in before:
            raise ConfigError(f"{name} is revoked already")
        if pool.holder(name).number is None:
            raise ConfigError(f"{directory} has no laptop {name!r}: `hexapod-gateway certs list` names them")
    entries = [Revoked(each.common_name, each.name, int(each.serial, 16), now) for each in fresh]
    entries = entries or [Revoked(name, "", _NO_SERIAL, now)]
    shut_out = {entry.common_name for entry in entries}
    others = sorted({each.name for each in present if each.common_name in shut_out and each not in fresh})
    if others and not others_too:
        raise ConfigError(
            f"{', '.join(others)} have the same common name, and would be shut out with {name}: give them others first "
            "(hexapod-gateway certs reissue), or say --others-too"
        )
    made = _sign(directory, ca, [*before.values(), *entries], (known, known_there), now)
    for each in present:
        if each.common_name in shut_out:
            _put_away(directory, each)
    return made


_NO_SERIAL = 1
"""For a certificate whose files are gone. Our serial numbers are random, so none has it."""


def merge(directory: Path, known_there: RevocationList, *, now: dt.datetime | None = None) -> RevocationList:
    """Sign a list with the entries of the folder's and a robot's list, newer than both."""
    now = now or folder.now_utc()
    known = folder.revoked(directory)
    entries = _entries(known, known_there).values()
    return _sign(directory, folder.load_ca(directory, now), entries, (known, known_there), now)


def _entries(*lists: RevocationList | None) -> dict[str, Revoked]:
    """The entries of all lists, by common name."""
    return {entry.common_name: entry for each in lists if each is not None for entry in each.entries}


def reissue(
    directory: Path,
    name: str,
    *,
    bundle: Path | None = None,
    days: int = LEAF_DAYS,
    now: dt.datetime | None = None,
) -> list[Path]:
    """Issue a laptop another certificate: a new key and common name, of the newest CA; returns the paths.

    The previous one works until it expires or is revoked.
    """
    found = next((each for each in folder.expiries(directory) if each.path.stem == name and _is_laptop(each)), None)
    if found is None:
        raise ConfigError(f"{directory} has no laptop {name!r}: `hexapod-gateway certs list` names them")
    folder.load_ca(directory, now or folder.now_utc())
    holder = pool.holder(found.common_name)
    if not any(pool.holder(each).number is not None for each in folder.listed_names(directory / "gateway.json5")):
        raise ConfigError(
            f"the rules in {directory} list no common name of its own for {name}: hexapod-gateway certs pool --dir "
            f"{directory}, and the same on the robot, in its folder"
        )
    _put_away(directory, found)
    return folder.issue(directory, name, holder.role, robots=holder.robots, bundle=bundle, days=days, now=now)


def set_pool(directory: Path, size: int = pool.SIZE) -> list[Path]:
    """List `size` common names of each role in gateway.json5 (and router.json5); returns the paths.

    The rest of the file stays, and no listed name is removed.
    """
    if size > pool.MAX_POOL:
        raise ConfigError(f"a pool of {size} common names will not do: {pool.MAX_POOL} at most")
    config = directory / "gateway.json5"
    listed = [pool.holder(name).number for name in folder.listed_names(config)]
    size = max(size, *(number + 1 for number in listed if number is not None), 1)
    text = read_file(config, "Zenoh configuration").decode()
    changed = _LISTED.sub(lambda found: _with_pool(found, size), text)
    if changed == text and not any(number is not None for number in listed):
        raise ConfigError(f"{config} lists no common names as `certs init` writes them: make it anew with certs init")
    replace(config, FileContent(changed.encode(), config.stat().st_mode & 0o777))
    if not (directory / ROUTER_FILE).exists():
        return [config]
    return [config, folder.write_router(directory)]


def replace_ca(directory: Path, *, now: dt.datetime | None = None) -> list[Path]:
    """Add a new CA; the old one stays valid until `drop_ca`. Returns the files to copy to the robot."""
    now = now or folder.now_utc()
    old, pem = folder.load_ca(directory, now), directory / "ca.pem"
    if len(read_certificates(pem)) > 1:
        raise ConfigError(f"{pem} has two CAs already: finish with `hexapod-gateway certs drop-ca --dir {directory}`")
    listed = (pool.holder(name).number for name in folder.listed_names(directory / "gateway.json5"))
    first = max((number + 1 for number in listed if number is not None), default=0)
    if first == 0:
        raise ConfigError(f"the rules list no pool of common names yet: hexapod-gateway certs pool --dir {directory}")
    paths = set_pool(directory, first + max(pool.SIZE, first - authority.first_number(old.certificate)))
    new = authority.make_ca(now, first)
    kept = directory / EARLIER / f"ca-{old.certificate.serial_number:x}"[:-24]
    kept.parent.mkdir(mode=0o700, exist_ok=True)
    replace(kept.with_suffix(".key"), FileContent(old.key_pem(), SECRET_MODE))
    replace(kept.with_suffix(".pem"), FileContent(old.certificate_pem()))
    replace(pem, FileContent(new.certificate_pem() + old.certificate_pem()))
    replace(directory / "ca.key", FileContent(new.key_pem(), SECRET_MODE))  # last: until now the old key fits
    known = folder.revoked(directory)
    if known is not None:
        _sign(directory, new, known.entries, (known,), now)
    return [pem, *paths]


def drop_ca(directory: Path, *, others_too: bool = False, now: dt.datetime | None = None) -> Path:
    """Remove the old of two CAs. Raises ConfigError while a certificate of it is in use, unless `others_too`."""
    ca, pem = folder.load_ca(directory, now or folder.now_utc()), directory / "ca.pem"
    if len(read_certificates(pem)) == 1:
        raise ConfigError(f"{pem} has one CA only")
    left = sorted(each.name for each in of_older_ca(directory))
    if left and not others_too:
        raise ConfigError(
            f"{', '.join(left)} still have certificates of the old CA: for a laptop hexapod-gateway certs reissue "
            "NAME, for the gateway and robots certs renew NAME; or say --others-too"
        )
    replace(pem, FileContent(ca.certificate_pem()))
    return pem


def of_older_ca(directory: Path) -> list[Certificate]:
    """The certificates in use that an older CA issued."""
    if not (directory / "ca.pem").exists():
        return []
    newest = read_certificates(directory / "ca.pem")[0]
    found = [each for each in folder.expiries(directory) if each.role not in (authority.CA, authority.CONSOLE)]
    return [each for each in found if not authority.is_issued(read_certificate(each.path), newest)]


def states(directory: Path, now: dt.datetime) -> list[tuple[Certificate, str]]:
    """All certificates of a folder with their states; replaced ones follow, then revoked ones without a file.

    Works on a robot and a laptop, too.
    """
    known, older = folder.revoked(directory), of_older_ca(directory)
    gone = [] if known is None else [*known.entries]
    found: list[tuple[Certificate, str]] = []
    for before, listed in (("", folder.expiries(directory)), ("replaced", folder.earlier(directory))):
        for each in listed:
            state = before or ("older CA" if each in older else "good")
            if known is not None and known.holds(each.common_name, int(each.serial, 16)):
                gone = [entry for entry in gone if entry.common_name != each.common_name]
                state = "revoked"
            elif each.not_after <= now:
                state = "expired"
            found.append((each, state))
    return [*found, *((_lost(entry), "revoked") for entry in gone)]


def _lost(entry: Revoked) -> Certificate:
    """The entry of a revoked certificate without a file; its expiry is unknown."""
    role = pool.holder(entry.common_name).of
    return Certificate(Path(), entry.name, role, entry.common_name, f"{entry.serial:x}", entry.since, entry.since)


def _sign(
    directory: Path,
    ca: authority.KeyPair,
    entries: Iterable[Revoked],
    before: Iterable[RevocationList | None],
    now: dt.datetime,
) -> RevocationList:
    """Sign a list newer than `before`, and write it to the folder."""
    number = 1 + max((each.number for each in before if each is not None), default=0)
    made = revocation.sign(ca, number, entries, now)
    replace(directory / revocation.REVOCATION_FILE, FileContent(made.pem))
    if (directory / ROUTER_FILE).exists():
        folder.write_router(directory)
    return made


def _with_pool(found: re.Match[str], size: int) -> str:
    """One list of common names, extended if it is of a role."""
    holders = [pool.holder(name) for name in _QUOTED.findall(found[1])]
    roles = {each.role for each in holders}
    if len(roles) != 1 or not roles <= {*LAPTOP_ROLES}:
        return found[0]
    return f"cert_common_names: {access.listed(pool.names(roles.pop(), range(size)))}"


def _is_laptop(certificate: Certificate) -> bool:
    return pool.holder(certificate.common_name).role in LAPTOP_ROLES


def _put_away(directory: Path, certificate: Certificate) -> None:
    """Move its files to `earlier`, with part of the serial number in their names."""
    target = directory / EARLIER
    target.mkdir(mode=0o700, exist_ok=True)
    stem = certificate.path.stem
    named = (certificate.path.with_name(f"{stem}{suffix}") for suffix in (".json5", ".key", ".pem"))
    for path in (*named, *directory.glob(f"{stem}.*.json5")):
        if path.exists():
            path.rename(target / path.name.replace(stem, f"{stem}-{certificate.serial[:8]}", 1))
