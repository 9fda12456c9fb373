"""Who reaches ROS 2's router: they all have the bridge's rights. Asked once, before the bridge serves anything.

rmw_zenohd listens on every address, without authentication, unless configured otherwise. So three things are looked at:
the endpoint that is dialled; the kernel's table, for a router on this machine; and what the router publishes of itself.
"""

import json
import socket
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Final

import zenoh

from gateway.endpoints import host_and_port, is_local
from gateway.errors import ConfigError
from gateway.host.sockets import listening
from gateway.people.client.diagnosis import demands_certificate
from gateway.people.client.requests import Identity

_ANSWER_S: Final = 1.0
_MOST_BYTES: Final = 1_000_000
"""Of what a router publishes of itself: some 200 bytes for each session."""


def check_closed(endpoint: str, router: zenoh.Session, identity: Identity) -> None:
    """Raises ConfigError where others reach the router without certificates, or where that is unknown."""
    found = sorted({*_open_here(endpoint, identity), *_open_elsewhere(router, identity)})
    if found:
        raise ConfigError(
            f"the ROS 2 router is open to the network without certificates ({', '.join(found)}), and anyone "
            "who reaches it could drive the robot: start it with "
            "ZENOH_CONFIG_OVERRIDE='listen/endpoints=[\"tcp/localhost:7447\"]', or with certificates "
            "(docs/ros2.md), or accept that with --open-graph"
        )


def _open_here(endpoint: str, identity: Identity) -> Iterator[str]:
    link, (host, port) = endpoint.partition("/")[0], host_and_port(endpoint)
    if is_local(endpoint) and not port.isdecimal():  # a Unix socket
        return
    addresses = {where for where, _ in listening(int(port), socket.SOCK_STREAM)} if is_local(endpoint) else {host}
    shown = [f"{link}/{f'[{each}]' if each.count(':') > 1 and '[' not in each else each}:{port}" for each in addresses]
    if not shown:  # behind a forwarded port, or on a system that shows nobody who listens
        yield f"{endpoint}: nobody sees who listens there"
    exposed = [each for each in shown if not is_local(each)]
    if exposed and not demands_certificate(endpoint, identity):
        yield from exposed


def _open_elsewhere(router: zenoh.Session, identity: Identity) -> Iterator[str]:
    """What the router says of itself: its other endpoints, and links to other routers."""
    for zid in router.info.routers_zid():
        replies: Any = router.get(f"@/{zid}/router", timeout=_ANSWER_S)
        for reply in replies:
            if reply.ok and len(reply.ok.payload) <= _MOST_BYTES:
                with suppress(ValueError, TypeError, KeyError, RecursionError):  # another version's, or a peer's joke
                    yield from _open_of(json.loads(reply.ok.payload.to_bytes()), identity)


def _open_of(published: dict[str, Any], identity: Identity) -> Iterator[str]:
    for each in published["locators"]:
        if not is_local(each) and not demands_certificate(each, identity):
            yield str(each)
    for session in published["sessions"]:
        for link in session["links"]:
            if session["whatami"] == "router" and not is_local(link["dst"]) and not link["dst"].startswith("tls/"):
                yield f"{link['dst']}, another router"
