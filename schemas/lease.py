"""The lease: requests on `hexapod/lease/cmd`, and the answer."""

from typing import Annotated, Final, Literal

from pydantic import ConfigDict, Field, TypeAdapter

from schemas.command import Closed, LeaseToken, Source, hex_digits
from schemas.telemetry import Answer

Nonce = Annotated[str, hex_digits(", from a challenge")]


class Proof(Closed):
    """Shows that the sender has the key of a certificate whose person is `source`."""

    nonce: Nonce
    certificate: Annotated[str, Field(description="the person's certificate as PEM")]
    signature: Annotated[str, Field(description="base64; of what `signed_text` returns, with the certificate's key")]


class Challenge(Closed):
    """Asks for a nonce."""

    do: Literal["challenge"]


class Claim(Closed):
    """Acquires the lease, asks its holder for it, or takes it from its holder."""

    do: Literal["acquire", "ask", "take"]
    source: Source
    proof: Proof | None = None


class Renew(Closed):
    """Keeps the lease for another `ttl_ms`."""

    do: Literal["renew"]
    lease: Annotated[LeaseToken, Field(repr=False)]


class Release(Closed):
    """Releases the lease, or hands it over to a client that has asked for it."""

    do: Literal["release"]
    lease: Annotated[LeaseToken, Field(repr=False)]
    to: Annotated[Source | None, Field(description="who gets it: one who has asked for it")] = None


LeaseRequest = Annotated[Challenge | Claim | Renew | Release, Field(discriminator="do")]
"""The payload of a `get` on `hexapod/lease/cmd`."""
LEASE_REQUEST: Final[TypeAdapter[Challenge | Claim | Renew | Release]] = TypeAdapter(
    LeaseRequest, config=ConfigDict(hide_input_in_errors=True)
)


class LeaseAck(Answer):
    """The answer to a LeaseRequest; null fields are left out of the JSON."""

    nonce: str | None = None
    lease: Annotated[str | None, Field(repr=False, description="the token that commands carry from now on")] = None
    holder: str | None = None
    ttl_ms: float | None = None
    verified: bool | None = None


def signed_text(do: str, source: str, nonce: str) -> bytes:
    """What a proof signs: ECDSA or RSA (PKCS #1 v1.5) with SHA-256."""
    return f"hexapod-lease-1\n{do}\n{source}\n{nonce}".encode()
