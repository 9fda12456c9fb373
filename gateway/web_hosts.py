"""Checks which browser requests are meant for one of our ports.

A page of another site reaches every port of its browser's machine: under its own origin, which `Origin` shows, or by a
name of its own that resolves to this machine (DNS rebinding), which `Host` shows. Both are rejected.
"""

from collections.abc import Collection
from typing import Final

LOOPBACK: Final = frozenset({"localhost", "127.0.0.1", "::1"})


def is_one_of(host: str | None, ours: Collection[str]) -> bool:
    """Whether a Host header (`robot.local:9464`, `[::1]:9464`) names one of these hosts, which are in lower case.

    The port is not compared: a tunnel has another, and no page can choose the host that its browser sends.
    """
    name = (host or "").lower()
    if name.startswith("["):
        name = name[1:].partition("]")[0]
    elif name.count(":") == 1:
        name = name.partition(":")[0]
    return name in ours


def may_ask(host: str | None, origin: str | None, ours: Collection[str]) -> bool:
    """Whether a request comes from no page (`origin` is None), or from our own."""
    return is_one_of(host, ours) and (origin is None or origin == f"http://{host}")
