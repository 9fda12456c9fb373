"""Finds messages on keys that nothing reads, such as a misspelt command key.

Without this, a client that misspells a key would get no error. A small ring keeps the newest messages below `hexapod/`,
and each beat reads it. In a flood Zenoh overwrites the oldest, which takes no Python time.
"""

import difflib
from functools import lru_cache
from typing import Any, Final

import zenoh
from zenoh.handlers import RingChannel

from schemas.keys import ALIVE, COMMAND_KEYS, GATEWAYS, ROOT, SIM_BODY

UNKNOWN_KEYS_DEPTH: Final = 36
"""Messages between two polls: six legs at 50 Hz send thirty, a simulated body three. Measured: reading thirty takes
40 µs, reading none 1.3 µs."""
MISSPELT: Final = ("Hexapod/**", "HEXAPOD/**")
"""They have no wildcard in the first part: with one, a router would forward unrelated keys."""
OURS: Final = frozenset({*COMMAND_KEYS, *GATEWAYS, ALIVE})
MAX_COMPARED: Final = 30
"""Characters that are compared; the gateway's keys have at most 20."""


class UnknownKeys:
    """Receives messages on all keys and finds those that no part of the gateway reads."""

    def __init__(self, session: zenoh.Session, physics: str | None = None) -> None:
        """`physics` is the Zenoh id of the only process that may publish SIM_BODY (None: none may)."""
        self._physics = physics
        self._subscribers: list[Any] = [
            session.declare_subscriber(key, RingChannel(depth), allowed_origin=zenoh.Locality.REMOTE)
            for key, depth in ((f"{ROOT}/**", UNKNOWN_KEYS_DEPTH), *((key, 1) for key in MISSPELT))
        ]

    def poll(self) -> tuple[str, str | None, str] | None:
        """Return the newest unknown key since the last poll, its source and what is wrong, or None.

        Ten polls a second give at most ten events.
        """
        found = None
        for subscriber in self._subscribers:
            for _ in range(UNKNOWN_KEYS_DEPTH):
                sample = subscriber.handler.try_recv()
                if sample is None:
                    break
                key = str(sample.key_expr)
                # Keys that end in /cmd are the inbox's; a wildcard may match other keys.
                if key in OURS or "*" in key or (key.startswith(f"{ROOT}/") and key.endswith("/cmd")):
                    continue
                source = None if sample.source_info is None else str(sample.source_info.source_id.zid)
                if key != SIM_BODY or source is None or source != self._physics:
                    found = key, source
        if found is None:
            return None
        if found[0] == SIM_BODY:
            return *found, "another program publishes it, not this gateway's physics; viewers ignore it"
        return *found, f"nothing reads this key; the nearest is {_nearest(found[0])}"


@lru_cache(maxsize=16)
def _nearest(key: str) -> str:
    """Return the command key that is most similar to `key`. Takes 0.5 ms."""
    return difflib.get_close_matches(key[:MAX_COMPARED].lower(), COMMAND_KEYS, n=1, cutoff=0)[0]
