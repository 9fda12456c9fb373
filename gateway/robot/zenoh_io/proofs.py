"""Checks the certificate of a client that asks for the lease or registers a button.

A check takes 0.3 ms. It runs on the receiver thread without the robot's state, so no command and no Stop waits for it.
At most `CHECKS_PER_S` run a second, since `cryptography` holds the interpreter's lock meanwhile.
"""

import datetime as dt
import secrets
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from gateway import certs
from gateway.allowance import Allowance
from gateway.nonces import Nonces
from schemas.lease import Proof

if TYPE_CHECKING:
    from gateway.certs.authority import Certificate
    from gateway.certs.proof import ProofChecker

CHECKS_PER_S: Final = 20
"""They hold the interpreter's lock for 6 ms a second. A person or program needs one check for each lease."""

NONCE_NS: Final = 5_000_000_000
"""docs/interface.md, Behaviour *Lease*. A laptop signs within milliseconds; a slow network adds a second."""


class Proofs:
    """Nonces and proofs of one key. Not thread-safe."""

    def __init__(
        self,
        checker: "ProofChecker | None",
        wall_clock: Callable[[], dt.datetime],
        fresh: Callable[[], str] = lambda: secrets.token_hex(16),
        *,
        watching: bool = False,
    ) -> None:
        """Without a `checker`, names are accepted unproved. `fresh` returns 128 random bits as hex.

        `watching` marks proofs of buttons, not of drivers.
        """
        self._checker = checker
        self._wall_clock = wall_clock
        self.fresh = fresh
        self._watching = watching
        self._nonces = Nonces(NONCE_NS)
        self._checks = Allowance(CHECKS_PER_S, CHECKS_PER_S)

    @property
    def wanted(self) -> bool:
        """Whether names must be proved."""
        return self._checker is not None

    def challenge(self, now_ns: int) -> str | None:
        """Return a new nonce for a proof, or None if no proof is needed."""
        return None if self._checker is None else self._nonces.issue(self.fresh(), now_ns)

    def why_denied(self, proof: Proof | None, do: str, source: str, now_ns: int) -> str | None:
        """Return why `proof` does not show that `source` requests `do`; None if it does, or no proof is needed."""
        if self._checker is None:
            return None
        if proof is None:
            return f"proof is missing: this gateway needs a proof that {do} comes from source"
        if not self._nonces.spend(proof.nonce, now_ns):
            return "proof.nonce is none of this gateway's, is older than 5 s, or has been used; get another (challenge)"
        if not self._checks.take(now_ns):
            return "too many proofs have come within a second; try again"
        purpose = certs.proof.WATCHING if self._watching else certs.proof.DRIVING
        return self._checker.fault(proof, do, source, self._wall_clock(), purpose)

    def holder(self, proof: Proof | None) -> "Certificate | None":
        """Return what the certificate of an accepted proof states, or None if no proof is needed."""
        return None if self._checker is None or proof is None else certs.proof.holder(proof)
