"""Zenoh configurations and sessions of the service and of clients.

A file's paths are relative to its own folder, so that the folder can be copied anywhere, and are made absolute here.
Zenoh itself would resolve them from the working directory: `/` for a service, any folder on a laptop.
"""

import datetime as dt
import json
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import zenoh

from gateway import certs
from gateway.errors import ConfigError, ZenohError
from gateway.files import nesting
from gateway.words.own_command import DEFAULT_ENDPOINT
from gateway.zenoh.endpoints import with_interface

TLS: Final = "transport/link/tls"
CA: Final = f"{TLS}/root_ca_certificate"
_CERTIFICATES = (CA, f"{TLS}/listen_certificate", f"{TLS}/connect_certificate")
_FILES = (
    *_CERTIFICATES,
    f"{TLS}/listen_private_key",
    f"{TLS}/connect_private_key",
    "transport/auth/usrpwd/dictionary_file",
    "transport/auth/pubkey/public_key_file",
    "transport/auth/pubkey/private_key_file",
    "transport/auth/pubkey/known_keys_file",
)

_MOST_CHARACTERS: Final = 300
RETRY: Final = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5}
"""Pauses with which a client reconnected after 0.35 s; with Zenoh's own it took 1 to 2 s."""


def load_config(path: Path) -> zenoh.Config:
    """Return the configuration at `path` (.json5 .json .yaml .toml) with absolute paths, ready for `zenoh.open`.

    Raises ConfigError, one line, if it is malformed, or a file that it names is missing or unreadable.
    """
    path = path.absolute()
    try:
        nesting.check(certs.files.read_file(path, "Zenoh configuration"))
        config = zenoh.Config.from_file(str(path))
    except (ValueError, zenoh.ZError) as error:
        raise ConfigError(f"{path}: {one_line(error)}") from error
    named = {setting: get(config, setting) for setting in _FILES}
    for setting, file in ((setting, path.parent / name) for setting, name in named.items() if isinstance(name, str)):
        try:
            if setting in _CERTIFICATES:
                certs.files.read_certificates(file)
            else:
                certs.files.read_file(file, setting.rpartition("/")[2])
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from error
        config.insert_json5(setting, json.dumps(str(file)))
    return config


def client_config(endpoint: str | None, file: Path | None = None) -> zenoh.Config:
    """Return a client's configuration: the file's (`--zenoh-config`), with `endpoint` in place of its endpoints.

    Without both, it reaches this machine's gateway. Raises ConfigError as `load_config` does, and for the gateway's own
    file or an expired certificate: `zenoh.open` would only report that it cannot connect.
    """
    if file is None:
        config = zenoh.Config()
        endpoint = DEFAULT_ENDPOINT if endpoint is None else endpoint
    else:
        config = load_config(file)
        if config.get_json(f"{TLS}/listen_private_key") != "null":
            own = "the gateway's own: give the NAME.json5 that `hexapod-gateway certs issue` made"
            raise ConfigError(f"{file} is {own}")
        first = first_expiry(config)
        if first is not None and first.end <= dt.datetime.now(dt.UTC):
            clock = f"is this clock right? Then {certs.renewal('NAME')}"
            raise ConfigError(f"{first.file} expired on {first.end:%Y-%m-%d}: {clock}")
    config.insert_json5("mode", '"client"')
    if endpoint is not None and "/" not in endpoint:
        endpoint = f"tcp/{endpoint}"
    dialled = connect_endpoints(config) if endpoint is None else [endpoint]
    try:
        config.insert_json5("connect/endpoints", json.dumps([*map(with_interface, dialled)]))
    except zenoh.ZError as error:
        raise ConfigError(f'"{", ".join(dialled)}" is no endpoint, such as {DEFAULT_ENDPOINT}') from error
    insert(config, "listen/endpoints", [], "listen")
    scouting_and_shared_memory_off(config)
    insert(config, "connect/retry", RETRY, "connect.retry")
    return config


def certificate_files(config: zenoh.Config) -> list[Path]:
    """Return the certificates named in a configuration of `load_config`, the CA first."""
    named = (get(config, setting) for setting in _CERTIFICATES)
    return [Path(file) for file in dict.fromkeys(named) if isinstance(file, str)]


class Expiry(NamedTuple):
    """When the certificate in `file` expires."""

    file: Path
    end: dt.datetime


def first_expiry(config: zenoh.Config) -> Expiry | None:
    """Return the first certificate to expire in a configuration of `load_config`; None: it names none.

    In a chain, the owner's counts, the first; of several CAs, the last to expire. Raises ConfigError.
    """
    ca = get(config, CA)
    found = []
    for file in certificate_files(config):
        ends = [certificate.not_valid_after_utc for certificate in certs.files.read_certificates(file)]
        found.append(Expiry(file, max(ends) if str(file) == ca else ends[0]))
    return min(found, key=lambda expiry: expiry.end, default=None)


def get(config: zenoh.Config, key: str) -> Any:
    """Return one value of a configuration; None: unset or unknown."""
    try:
        return json.loads(config.get_json(key))
    except zenoh.ZError:
        return None


def _endpoints(direction: str, config: zenoh.Config) -> list[str]:
    """Return the endpoints that this configuration listens on or dials, in its mode."""
    found = get(config, f"{direction}/endpoints")
    if isinstance(found, dict):  # endpoints by mode
        found = found.get(get(config, "mode") or "peer", [])
    return [found] if isinstance(found, str) else list(map(str, found or []))


listen_endpoints: Final = partial(_endpoints, "listen")
connect_endpoints: Final = partial(_endpoints, "connect")


def one_line(error: BaseException) -> str:
    """Return Zenoh's reason without its source position, and without the file, which it may quote whole."""
    said = " ".join(str(error).split()).partition(" at /")[0]
    return said if len(said) <= _MOST_CHARACTERS else f"{said[:_MOST_CHARACTERS]}…"


def insert(config: zenoh.Config, key: str, value: object, setting: str) -> None:
    """Set one value. Raises ConfigError, with the name `setting`, if Zenoh rejects it."""
    try:
        config.insert_json5(key, json.dumps(value))
    except zenoh.ZError as error:
        raise ConfigError(f"{setting}: {value} is not allowed: {one_line(error)}") from error


def scouting_and_shared_memory_off(config: zenoh.Config) -> None:
    """Switch both off: scouting unless the file turns it on, so that no peers connect by accident.

    A session with shared memory opens only if /dev/shm has room, and a Stop must not wait for that. It also bypasses
    every size limit, and saves no time for messages this small.
    """
    config.insert_json5("transport/shared_memory/enabled", "false")
    for key in ("scouting/multicast/enabled", "scouting/gossip/enabled"):
        if get(config, key) is not True:
            config.insert_json5(key, "false")


def open_session(config: zenoh.Config) -> zenoh.Session:
    """Open a session. Raises ZenohError with one line."""
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        endpoints = listen_endpoints(config) or connect_endpoints(config)
        raise ZenohError(why_not_opened(one_line(error), endpoints)) from error


CANNOT_CONNECT: Final = "Unable to connect"


def why_not_opened(text: str, endpoints: list[str]) -> str:
    """Return Zenoh's `text` as a sentence with a remedy."""
    where = ", ".join(endpoints)
    if "Address already in use" in text:
        return f"{where} is taken by another program (perhaps another gateway); stop it, or set another zenoh.listen"
    if "Cannot assign requested address" in text:
        return f"{where} is no address of this machine; set another zenoh.listen"
    if "KeyMismatch" in text:
        return "the Zenoh file names a private key that is not its certificate's: sudo hexapod-gateway check names both"
    if CANNOT_CONNECT in text:
        return f"no gateway answers on {where}; is it running, and does it know your certificate?"
    return f"Zenoh cannot be opened on {where}: {text}"
