"""Rejects configurations with which a stranger on the network could move the robot; the gateway then does not start.

A listen endpoint that is not loopback needs TLS with client certificates, or user and password, or the deliberate
`zenoh.allow_insecure = true`. An endpoint that is not understood here counts as exposed.
"""

import ipaddress
import logging
from pathlib import Path
from typing import Final

import zenoh

from gateway.errors import ConfigError
from gateway.zenoh_config import connect_endpoints, get, listen_endpoints

_LOCAL_LINKS: Final = frozenset({"unixsock-stream", "unixpipe"})
"""Links that do not leave the machine; who may use them is a matter of file permissions."""
_IP_LINKS: Final = frozenset({"tcp", "udp", "tls", "quic", "ws"})
_TLS_LINKS: Final = frozenset({"tls", "quic"})

logger = logging.getLogger(__name__)


def check(config: zenoh.Config, *, allow_insecure: bool) -> None:
    """Reject, or with `allow_insecure` warn of, endpoints on which anyone may command. Raises ConfigError."""
    listen = listen_endpoints(config)
    if not listen and not connect_endpoints(config):
        raise ConfigError("zenoh.listen and zenoh.connect are both empty, so nobody could reach the gateway")
    _check_namespace(config)
    _check_links(listen + connect_endpoints(config), config)
    open_to_anyone = [endpoint for endpoint in listen if is_open_to_anyone(endpoint, config)]
    if open_to_anyone and not allow_insecure:
        raise ConfigError(
            f"{', '.join(open_to_anyone)} would let anyone on the network move the robot: {_way_on(config)}, "
            "or set zenoh.allow_insecure = true"
        )
    if open_to_anyone:
        logger.warning("zenoh.allow_insecure: anyone who reaches %s can move the robot", ", ".join(open_to_anyone))
    for endpoint in connect_endpoints(config):
        if not is_local(endpoint) and not _knows_whom_it_dials(endpoint, config):
            logger.warning(
                "%s is dialled without TLS, or without checking the name in its certificate: anyone on the way to it, "
                "and behind it, can move the robot",
                endpoint,
            )
    if _dials_whom_it_finds(config):
        logger.warning(
            "the Zenoh file turns scouting on, and not only for TLS: the gateway dials whoever it finds on the "
            "network, and they can move the robot"
        )
    if get(config, "access_control/rules") and get(config, "access_control/enabled") is not True:
        logger.warning("access_control has rules, but is not enabled; Zenoh ignores them")


def _check_links(endpoints: list[str], config: zenoh.Config) -> None:
    """With certificates, a session that must not be there is ended by shutting down its socket, which QUIC's one UDP
    socket for all sessions does not allow: the revoked would stay, and take the operators' places. Raises ConfigError.
    """
    quic = [endpoint for endpoint in endpoints if endpoint.startswith("quic")]
    by_certificate = get(config, "transport/link/tls/root_ca_certificate") or get(config, "access_control/enabled")
    if quic and by_certificate:
        raise ConfigError(
            f"{', '.join(quic)}: over QUIC nobody who is revoked can be shut out, and no place be kept for operators; "
            "with certificates, write tls/ in place of quic/"
        )


def _check_namespace(config: zenoh.Config) -> None:
    """Access control without the robot's namespace blocks everybody, even the emergency stop. Raises ConfigError."""
    namespace, rules = get(config, "namespace"), get(config, "access_control/rules")
    if not namespace or not rules or get(config, "access_control/enabled") is not True:
        return
    keys = [key for rule in rules for key in rule.get("key_exprs") or []]
    if not any(key.startswith((f"{namespace}/", "*")) for key in keys):
        raise ConfigError(
            f"the Zenoh file has the namespace {namespace}, but no key in its access control begins with it, so nobody "
            f"could command the robot: make the file with `hexapod-gateway certs init --namespace {namespace}`"
        )


def is_open_to_anyone(endpoint: str, config: zenoh.Config) -> bool:
    """Whether somebody on another machine needs neither certificate nor password to use `endpoint`."""
    return not (
        is_local(endpoint)
        or _demands_certificate(endpoint, config)
        or (_demands_password(config) and not _may_be_multicast(endpoint))
    )


def is_local(endpoint: str) -> bool:
    """Whether only this machine reaches it: `tcp/127.0.0.1:7447`, `tcp/[::1]:7447`, a Unix socket."""
    link, _, rest = endpoint.partition("/")
    if link in _LOCAL_LINKS:
        return True
    if link not in _IP_LINKS:
        return False
    ip = _ip(rest)
    return _host(rest) == "localhost" or (ip is not None and ip.is_loopback)


def _host(address: str) -> str:
    return address.partition("#")[0].partition("?")[0].rpartition(":")[0].removeprefix("[").removesuffix("]")


def _ip(address: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """None for a name: its address may change."""
    try:
        ip = ipaddress.ip_address(_host(address))
    except ValueError:
        return None
    return (ip.ipv4_mapped if isinstance(ip, ipaddress.IPv6Address) else None) or ip


def _may_be_multicast(endpoint: str) -> bool:
    """A multicast group has no sessions, so Zenoh asks for no password and takes what anyone sends there."""
    link, _, rest = endpoint.partition("/")
    ip = _ip(rest)
    return link == "udp" and (ip is None or ip.is_multicast)


def _is_tls(endpoint: str) -> bool:
    return endpoint.partition("/")[0] in _TLS_LINKS


def _demands_certificate(endpoint: str, config: zenoh.Config) -> bool:
    # An endpoint can carry settings of its own behind a "#", which override the file's.
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
    # Zenoh switches authentication off if the dictionary is empty, so it must hold at least one user.
    file = get(config, "transport/auth/usrpwd/dictionary_file")
    if not isinstance(file, str):
        return False
    try:
        lines = Path(file).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise ConfigError(f"{file}: the password file cannot be read: {error}") from error
    return any(user and password for user, _, password in (line.strip().partition(":") for line in lines))
