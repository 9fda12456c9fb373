"""The lease: requests on `hexapod/lease/cmd`, and the answer."""

from typing import Annotated, Final, Literal

from pydantic import ConfigDict, Field, TypeAdapter

from schemas.ack import Answer
from schemas.command import Closed, LeaseToken, Source, hex_digits

Nonce = Annotated[str, hex_digits("from a challenge; valid once, for 5 s")]


class Proof(Closed):
    """Shows that the sender has the key of a certificate whose person is `source`."""

    nonce: Nonce
    certificate: Annotated[str, Field(description="PEM, of the sender")]
    signature: Annotated[str, Field(description="base64 (Behaviour *Proof*)")]


class Challenge(Closed):
    """Asks for a nonce."""

    do: Literal["challenge"]


class Claim(Closed):
    """Acquires the lease, asks its holder for it, or takes it from its holder."""

    do: Annotated[Literal["acquire", "ask", "take"], Field(description="as in Behaviour *Lease*")]
    source: Source
    proof: Annotated[Proof | None, Field(description="if the gateway has a CA (Behaviour *Proof*)")] = None


class Renew(Closed):
    """Keeps the lease for another `ttl_ms`."""

    do: Literal["renew"]
    lease: Annotated[LeaseToken, Field(repr=False)]


class Release(Closed):
    """Releases the lease, or hands it over to a client that has asked for it."""

    do: Literal["release"]
    lease: Annotated[LeaseToken, Field(repr=False)]
    to: Annotated[Source | None, Field(description="the next holder, one that asked")] = None


LeaseRequest = Annotated[Challenge | Claim | Renew | Release, Field(discriminator="do")]
"""The payload of a `get` on `hexapod/lease/cmd`."""
LEASE_REQUEST: Final[TypeAdapter[Challenge | Claim | Renew | Release]] = TypeAdapter(
    LeaseRequest, config=ConfigDict(hide_input_in_errors=True)
)


class LeaseAck(Answer):
    """The answer to a LeaseRequest; null fields are left out of the JSON."""

    nonce: Annotated[str | None, Field(description="of a challenge, if a proof is needed")] = None
    lease: Annotated[str | None, Field(repr=False, description="token for commands, a secret")] = None
    holder: Annotated[str | None, Field(description="who holds the lease, or may acquire it")] = None
    ttl_ms: Annotated[float | None, Field(description="the setting; renew more often than this")] = None
    verified: Annotated[bool | None, Field(description="whether a certificate proved the name")] = None


def signed_text(do: str, source: str, nonce: str) -> bytes:
    """Return what a proof signs: ECDSA or RSA (PKCS #1 v1.5) with SHA-256."""
    return f"hexapod-lease-1\n{do}\n{source}\n{nonce}".encode()
