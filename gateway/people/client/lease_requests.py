"""What is asked of a gateway about its lease, and the answers. Tokens pass through here and stay nowhere."""

import json
from typing import TYPE_CHECKING, Any, Protocol

from gateway.people.client.proof import Identity
from schemas.keys import LEASE

if TYPE_CHECKING:
    from schemas.lease import LeaseAck


class _Get(Protocol):
    def __call__(self, key: str, payload: str, answer: "type[LeaseAck]", *, timeout_s: float | None) -> "LeaseAck": ...


class LeaseRequests:
    """The questions on `hexapod/lease/cmd`. All raise DisconnectedError where nobody answers."""

    def __init__(self, get: _Get, identity: Identity | None, name: str) -> None:
        """`get` asks, with a time limit (None: the client's own). `name` is ours without a certificate."""
        self._get = get
        self._identity = identity
        self._name = name

    def person(self, name: str | None = None) -> str:
        """Who we are to the lease: our certificate's person, else `name`, else the client's. Raises ConfigError."""
        return (name or self._name) if self._identity is None else self._identity.person()

    def as_person(self, do: str, name: str | None = None) -> "LeaseAck":
        """`acquire`, `ask` or `take`, proved where we have a certificate. Raises ConfigError for a key that cannot."""
        request: dict[str, Any] = {"do": do, "source": self.person(name)}
        if self._identity is not None:
            nonce = self._ask({"do": "challenge"}).nonce
            if nonce is not None:
                request["proof"] = self._identity.prove(do, request["source"], nonce)
        return self._ask(request)

    def renew(self, token: str, timeout_s: float | None = None) -> "LeaseAck":
        """Hold it for another `ttl_ms`."""
        return self._ask({"do": "renew", "lease": token}, timeout_s)

    def release(self, token: str, to: str | None = None, timeout_s: float | None = None) -> "LeaseAck":
        """Give it back, or over to somebody."""
        return self._ask({"do": "release", "lease": token, **({} if to is None else {"to": to})}, timeout_s)

    def _ask(self, request: dict[str, Any], timeout_s: float | None = None) -> "LeaseAck":
        from schemas.lease import LeaseAck  # no emergency stop waits for what it loads

        return self._get(LEASE, json.dumps(request), LeaseAck, timeout_s=timeout_s)
