"""Finds messages on keys that nothing reads, such as a misspelt command key.

Without this, a client that misspells a key would get no error. A small ring keeps the newest messages below `hexapod/`,
and the gateway reads it ten times a second. In a flood Zenoh overwrites the oldest, which takes no Python time.
"""

import difflib
import re
from typing import Any, Final, NamedTuple

import zenoh
from zenoh.handlers import RingChannel

from schemas.keys import ALIVE, COMMAND_KEYS, GATEWAYS, ROOT, SIM_BODY, leg_command, servo_command

UNKNOWN_KEYS_DEPTH: Final = 36
"""Messages between two polls: six legs at 50 Hz send thirty, a simulated body three. Measured: reading thirty takes
40 µs, reading none 1.3 µs."""
MISSPELT: Final = ("Hexapod/**", "HEXAPOD/**")
"""They have no wildcard in the first part: with one, a router would forward unrelated keys."""
OURS: Final = frozenset({*COMMAND_KEYS, *GATEWAYS, ALIVE})
MAX_COMPARED: Final = 30
"""Characters that are compared; the gateway's keys have at most 20."""


class UnknownKey(NamedTuple):
    """A message on a key that nothing reads."""

    key: str
    source: str | None
    detail: str


class UnknownKeys:
    """Receives messages on all keys and finds those that no part of the gateway reads."""

    def __init__(self, session: zenoh.Session, physics: str | None = None) -> None:
        """`physics` is the Zenoh id of the only process that may publish SIM_BODY (None: none may)."""
        self._physics = physics
        self._subscribers: list[Any] = [
            session.declare_subscriber(key, RingChannel(depth), allowed_origin=zenoh.Locality.REMOTE)
            for key, depth in ((f"{ROOT}/**", UNKNOWN_KEYS_DEPTH), *((key, 1) for key in MISSPELT))
        ]

    def poll(self) -> UnknownKey | None:
        """Return the newest unknown key since the last poll, or None. Ten polls a second give at most ten events."""
        found = None
        for subscriber in self._subscribers:
            for _ in range(UNKNOWN_KEYS_DEPTH):
                sample = subscriber.handler.try_recv()
                if sample is None:
                    break
                if is_strange(str(sample.key_expr)) and not self._is_physics(sample):
                    found = sample
        if found is None:
            return None
        key = str(found.key_expr)
        if key == SIM_BODY:
            why = (
                "another program publishes it, not this gateway's physics" if self._physics else "no physics runs here"
            )
            return UnknownKey(key, _source(found), f"{why}; viewers ignore this one")
        return UnknownKey(key, _source(found), f"nothing reads this key; the nearest is {nearest(key)}")

    def _is_physics(self, sample: zenoh.Sample) -> bool:
        return str(sample.key_expr) == SIM_BODY and self._physics is not None and _source(sample) == self._physics


def _source(sample: zenoh.Sample) -> str | None:
    return None if sample.source_info is None else str(sample.source_info.source_id.zid)


def is_strange(key: str) -> bool:
    """Return whether nothing reads this key. Keys that end in /cmd are the inbox's; a wildcard may match other keys."""
    return key not in OURS and "*" not in key and not (key.startswith(f"{ROOT}/") and key.endswith("/cmd"))


def nearest(key: str) -> str:
    """Return the command key that is most similar to `key`. Takes 0.1 ms at most, since few are compared."""
    small = key[:MAX_COMPARED].lower()
    for guess in (small, f"{small}/cmd", f"{small.rpartition('/')[0]}/cmd"):
        if guess in COMMAND_KEYS:
            return guess
    digits = re.findall(r"[1-9]\d?", small)
    named = [key for key, command in COMMAND_KEYS.items() if str(command.number) in digits] or _UNNUMBERED
    middle = small.removeprefix(f"{ROOT}/").removesuffix("/cmd")
    found = difflib.get_close_matches(middle, [_middle(key) for key in (*named, *_WHOLE)], n=1, cutoff=0)
    return f"{ROOT}/{found[0]}/cmd"


def _middle(key: str) -> str:
    return key.removeprefix(f"{ROOT}/").removesuffix("/cmd")


_WHOLE: Final = tuple(key for key, command in COMMAND_KEYS.items() if not command.number)
_UNNUMBERED: Final = [leg_command(1), servo_command(11)]
