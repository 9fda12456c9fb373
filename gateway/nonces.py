"""Nonces that prove a secret without sending it. Pure."""

from typing import Final

MOST_NONCES: Final = 256
"""The most open nonces: one more replaces the oldest. A flood of challenges hurts only clients that use theirs late."""


class Nonces:
    """Issued nonces that are not used yet. Each is valid once, for a short time."""

    def __init__(self, valid_ns: int) -> None:
        self._valid_ns = valid_ns
        self._until_ns: dict[str, int] = {}

    def issue(self, nonce: str, now_ns: int) -> str:
        """Issue this nonce (128 random bits) and return it."""
        if len(self._until_ns) >= MOST_NONCES:
            del self._until_ns[next(iter(self._until_ns))]
        self._until_ns[nonce] = now_ns + self._valid_ns
        return nonce

    def spend(self, nonce: str, now_ns: int) -> bool:
        """Return whether this nonce is valid, and invalidate it."""
        until_ns = self._until_ns.pop(nonce, None)
        return until_ns is not None and now_ns < until_ns
