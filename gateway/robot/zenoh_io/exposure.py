"""Rejects configurations that let anyone on the network move the robot. The gateway then does not start.

A listen endpoint other than loopback needs TLS with client certificates, user and password, or the explicit
`zenoh.allow_insecure = true`. An endpoint of an unknown kind counts as exposed.
"""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import zenoh

from gateway.errors import ConfigError
from gateway.zenoh.config import CA, TLS, connect_endpoints, get, listen_endpoints
from gateway.zenoh.endpoints import ip_of, is_local

_TLS_LINKS: Final = frozenset({"tls", "quic"})
_CONTROLLED: Final = "access_control/enabled"

logger = logging.getLogger(__name__)


def check(config: zenoh.Config, *, allow_insecure: bool) -> None:
    """Raise ConfigError for an endpoint on which anyone may command. With `allow_insecure`, only warn of it."""
    listen, dialled = listen_endpoints(config), connect_endpoints(config)
    if not listen and not dialled:
        raise ConfigError("zenoh.listen is empty, and the Zenoh file dials nobody, so nobody could reach the gateway")
    namespace, rules = get(config, "namespace"), get(config, "access_control/rules")
    keys = [key for rule in rules or () for key in rule.get("key_exprs") or ()]
    controlled = get(config, _CONTROLLED) is True
    if namespace and rules and controlled and not any(key.startswith((f"{namespace}/", "*")) for key in keys):
        raise ConfigError(
            f"the Zenoh file has the namespace {namespace}, but no key in its access control begins with it, so nobody "
            "could command the robot, not even its emergency stop: write it before each key in the rules"
        )
    quic = ", ".join(endpoint for endpoint in listen + dialled if endpoint.startswith("quic"))
    # All QUIC sessions share one UDP socket, which cannot be shut down.
    if quic and (get(config, CA) or controlled):
        raise ConfigError(
            f"{quic}: over QUIC, revoked clients cannot be disconnected, and no places can be kept for operators; with "
            "certificates, write tls/ in place of quic/"
        )
    if (exposed := _open_to_anyone(config)) and not allow_insecure:
        raise ConfigError(
            f"{exposed} would let anyone on the network move the robot: make certificates with `hexapod-gateway certs "
            "init`, set zenoh.config, and write tls/ before the address; or set zenoh.allow_insecure = true"
        )
    for each in warnings(config):
        logger.warning(each)


def warnings(config: zenoh.Config) -> Iterator[str]:
    """Yield a sentence for each way in which an accepted configuration lets others move the robot."""
    if open_to_anyone := _open_to_anyone(config):
        yield f"zenoh.allow_insecure: anyone who reaches {open_to_anyone} can move the robot"
    for endpoint in connect_endpoints(config):
        checks_name = get(config, f"{TLS}/verify_name_on_connect") is not False
        if not is_local(endpoint) and not (checks_name and _is_tls(endpoint, "verify_name")):
            yield (
                f"{endpoint} is dialled without TLS, or without checking the name in its certificate: anyone on the "
                "way to it or behind it can move the robot"
            )
    links = get(config, "transport/link/protocols")
    only_tls = bool(links) and _TLS_LINKS.issuperset(links)
    if not only_tls and any(get(config, f"scouting/{way}/enabled") is True for way in ("multicast", "gossip")):
        yield (
            "the Zenoh file turns scouting on, and not only for TLS: the gateway dials every Zenoh program that it "
            "finds on the network, and these can move the robot"
        )
    if get(config, "access_control/rules") and get(config, _CONTROLLED) is not True:
        yield "access_control has rules, but is not enabled; Zenoh ignores them"


def _open_to_anyone(config: zenoh.Config) -> str:
    """Return the endpoints that another machine reaches without a certificate or password."""
    certificates = get(config, f"{TLS}/enable_mtls") is True and get(config, CA)
    exposed = [
        each
        for each in listen_endpoints(config)
        if not is_local(each) and not (certificates and _is_tls(each, "mtls", "root_ca"))
    ]
    if exposed and _demands_password(config):
        # Multicast groups have no sessions, so Zenoh demands no password there. A name may be a group's.
        exposed = [
            each for each in exposed if each.startswith("udp/") and ((ip := ip_of(each)) is None or ip.is_multicast)
        ]
    return ", ".join(exposed)


def _is_tls(endpoint: str, *overrides: str) -> bool:
    """Return whether it is TLS without these settings after its "#", which would override the file's."""
    settings = endpoint.partition("#")[2]
    return endpoint.partition("/")[0] in _TLS_LINKS and not any(each in settings for each in overrides)


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
