"""Zenoh's endpoints, such as `tls/192.168.1.7:7447`: which of them only this machine reaches. Pure."""

import ipaddress
from typing import Final

_LOCAL_LINKS: Final = frozenset({"unixsock-stream", "unixpipe"})
"""Links that do not leave the machine; who may use them is a matter of file permissions."""
_IP_LINKS: Final = frozenset({"tcp", "udp", "tls", "quic", "ws"})


def is_local(endpoint: str) -> bool:
    """Whether only this machine reaches it: `tcp/127.0.0.1:7447`, `tcp/[::1]:7447`, a Unix socket."""
    link, _, rest = endpoint.partition("/")
    if link in _LOCAL_LINKS:
        return True
    if link not in _IP_LINKS:
        return False
    ip = ip_of(rest)
    return _host(rest) == "localhost" or (ip is not None and ip.is_loopback)


def ip_of(address: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """The address in `host:port`; None for a name: its address may change."""
    try:
        ip = ipaddress.ip_address(_host(address))
    except ValueError:
        return None
    return (ip.ipv4_mapped if isinstance(ip, ipaddress.IPv6Address) else None) or ip


def _host(address: str) -> str:
    return address.partition("#")[0].partition("?")[0].rpartition(":")[0].removeprefix("[").removesuffix("]")
