"""Nonces for proofs: each serves once, for a short time. Pure: time and randomness are arguments."""

from typing import Final

NONCE_NS: Final = 5_000_000_000
"""docs/interface.md, Behaviour *Lease*: a laptop signs within milliseconds, and a slow network adds a second."""
MOST_NONCES: Final = 256
"""At a time. For one more the oldest is forgotten: a flood of challenges hurts those who are slow to use theirs."""


class Nonces:
    """Those that were given out and not used."""

    def __init__(self) -> None:
        self._until_ns: dict[str, int] = {}

    def issue(self, nonce: str, now_ns: int) -> str:
        """Give out this nonce, 128 random bits."""
        if len(self._until_ns) >= MOST_NONCES:
            del self._until_ns[next(iter(self._until_ns))]
        self._until_ns[nonce] = now_ns + NONCE_NS
        return nonce

    def spend(self, nonce: str, now_ns: int) -> bool:
        """Whether this nonce serves; from now on it does not."""
        until_ns = self._until_ns.pop(nonce, None)
        return until_ns is not None and now_ns < until_ns
