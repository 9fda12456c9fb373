"""Rejects configurations that let anyone on the network move the robot. The gateway then does not start.

A listen endpoint other than loopback needs TLS with client certificates, user and password, or the explicit
`zenoh.allow_insecure = true`. An endpoint of an unknown kind counts as exposed.
"""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import zenoh

from gateway.endpoints import ip_of, is_local
from gateway.errors import ConfigError
from gateway.zenoh_config import connect_endpoints, get, listen_endpoints

_TLS_LINKS: Final = frozenset({"tls", "quic"})

logger = logging.getLogger(__name__)


def check(config: zenoh.Config, *, allow_insecure: bool) -> None:
    """Raise ConfigError for an endpoint on which anyone may command. With `allow_insecure`, only warn of it."""
    listen = listen_endpoints(config)
    if not listen and not connect_endpoints(config):
        raise ConfigError("zenoh.listen is empty, and the Zenoh file dials nobody, so nobody could reach the gateway")
    _check_namespace(config)
    _check_links(listen + connect_endpoints(config), config)
    open_to_anyone = [endpoint for endpoint in listen if is_open_to_anyone(endpoint, config)]
    if open_to_anyone and not allow_insecure:
        raise ConfigError(
            f"{', '.join(open_to_anyone)} would let anyone on the network move the robot: {_way_on(config)}, "
            "or set zenoh.allow_insecure = true"
        )
    for each in warnings(config):
        logger.warning(each)


def warnings(config: zenoh.Config) -> Iterator[str]:
    """Yield a sentence for each way in which an accepted configuration lets others move the robot."""
    open_to_anyone = [endpoint for endpoint in listen_endpoints(config) if is_open_to_anyone(endpoint, config)]
    if open_to_anyone:
        yield f"zenoh.allow_insecure: anyone who reaches {', '.join(open_to_anyone)} can move the robot"
    for endpoint in connect_endpoints(config):
        if not is_local(endpoint) and not _knows_whom_it_dials(endpoint, config):
            yield (
                f"{endpoint} is dialled without TLS, or without checking the name in its certificate: anyone on the "
                "way to it or behind it can move the robot"
            )
    if _dials_whom_it_finds(config):
        yield (
            "the Zenoh file turns scouting on, and not only for TLS: the gateway dials every Zenoh program that it "
            "finds on the network, and these can move the robot"
        )
    if get(config, "access_control/rules") and get(config, "access_control/enabled") is not True:
        yield "access_control has rules, but is not enabled; Zenoh ignores them"


def _check_links(endpoints: list[str], config: zenoh.Config) -> None:
    """Raise ConfigError for QUIC with certificates.

    All QUIC sessions share one UDP socket. So a revoked client could not be shut down, and would keep an operator's
    place.
    """
    quic = [endpoint for endpoint in endpoints if endpoint.startswith("quic")]
    by_certificate = get(config, "transport/link/tls/root_ca_certificate") or get(config, "access_control/enabled")
    if quic and by_certificate:
        raise ConfigError(
            f"{', '.join(quic)}: over QUIC, revoked clients cannot be disconnected, and no places can be kept for "
            "operators; with certificates, write tls/ in place of quic/"
        )


def _check_namespace(config: zenoh.Config) -> None:
    """Raise ConfigError if the rules lack the robot's namespace, since they would block even the emergency stop."""
    namespace, rules = get(config, "namespace"), get(config, "access_control/rules")
    if not namespace or not rules or get(config, "access_control/enabled") is not True:
        return
    keys = [key for rule in rules for key in rule.get("key_exprs") or []]
    if not any(key.startswith((f"{namespace}/", "*")) for key in keys):
        raise ConfigError(
            f"the Zenoh file has the namespace {namespace}, but no key in its access control begins with it, so nobody "
            f"could command the robot: write it before each key in the rules"
        )


def is_open_to_anyone(endpoint: str, config: zenoh.Config) -> bool:
    """Return whether `endpoint` can be reached from another machine without a certificate or password."""
    return not (
        is_local(endpoint)
        or _demands_certificate(endpoint, config)
        or (_demands_password(config) and not _may_be_multicast(endpoint))
    )


def _may_be_multicast(endpoint: str) -> bool:
    """Return whether it may be a multicast group. Groups have no sessions, so Zenoh demands no password there."""
    ip = ip_of(endpoint)
    return endpoint.startswith("udp/") and (ip is None or ip.is_multicast)


def _is_tls(endpoint: str) -> bool:
    return endpoint.partition("/")[0] in _TLS_LINKS


def _demands_certificate(endpoint: str, config: zenoh.Config) -> bool:
    # Settings after an endpoint's "#" override the file's.
    overrides = endpoint.partition("#")[2]
    return (
        _is_tls(endpoint)
        and get(config, "transport/link/tls/enable_mtls") is True
        and bool(get(config, "transport/link/tls/root_ca_certificate"))
        and "mtls" not in overrides
        and "root_ca" not in overrides
    )


def _knows_whom_it_dials(endpoint: str, config: zenoh.Config) -> bool:
    return (
        _is_tls(endpoint)
        and get(config, "transport/link/tls/verify_name_on_connect") is not False
        and "verify_name" not in endpoint.partition("#")[2]
    )


def _dials_whom_it_finds(config: zenoh.Config) -> bool:
    links = get(config, "transport/link/protocols")
    only_tls = bool(links) and _TLS_LINKS.issuperset(links)
    return not only_tls and any(get(config, f"scouting/{way}/enabled") is True for way in ("multicast", "gossip"))


def _way_on(config: zenoh.Config) -> str:
    if _demands_certificate("tls/", config):
        return "there are certificates, so write tls/ before the address, and no TLS settings after it"
    return "make certificates with `hexapod-gateway certs init` and set zenoh.config"


def _demands_password(config: zenoh.Config) -> bool:
    # With an empty dictionary Zenoh switches authentication off.
    file = get(config, "transport/auth/usrpwd/dictionary_file")
    if not isinstance(file, str):
        return False
    try:
        lines = Path(file).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise ConfigError(f"{file}: the password file cannot be read: {error}") from error
    return any(user and password for user, _, password in (line.strip().partition(":") for line in lines))
