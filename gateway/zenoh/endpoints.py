"""Parses Zenoh's endpoints, such as `tls/192.168.1.7:7447`. Pure."""

import ipaddress
import re
from typing import Final

_LOCAL_LINKS: Final = frozenset({"unixsock-stream", "unixpipe"})
"""Links that do not leave the machine; file permissions control who may use them."""
_IP_LINKS: Final = frozenset({"tcp", "udp", "tls", "quic", "ws"})


def is_local(endpoint: str) -> bool:
    """Return whether only this machine reaches it: `tcp/127.0.0.1:7447`, `tcp/[::1]:7447`, a Unix socket."""
    link, ip = endpoint.partition("/")[0], ip_of(endpoint)
    if link in _LOCAL_LINKS:
        return True
    if link not in _IP_LINKS:
        return False
    return host_and_port(endpoint)[0] == "localhost" or (ip is not None and ip.is_loopback)


def with_interface(endpoint: str) -> str:
    """Return the endpoint as Zenoh reads it: `tcp/[fe80::1]:7447#iface=wlan0` for `tcp/[fe80::1%wlan0]:7447`."""
    return re.sub(r"(\[[^\]%]+)%([^\]]+)(\]:\d+)$", r"\1\3#iface=\2", endpoint)


def host_and_port(endpoint: str) -> tuple[str, str]:
    """Return `::1` and `7447` of `tls/[::1]:7447?…#…`. The host of an endpoint without a port is ""."""
    host, _, port = endpoint.partition("/")[2].partition("#")[0].partition("?")[0].rpartition(":")
    return host.removeprefix("[").removesuffix("]"), port


def ip_of(endpoint: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """Return the endpoint's IP address; None for a name, whose address may change, and for a Unix socket."""
    try:
        ip = ipaddress.ip_address(host_and_port(endpoint)[0])
    except ValueError:
        return None
    return (ip.ipv4_mapped if isinstance(ip, ipaddress.IPv6Address) else None) or ip
