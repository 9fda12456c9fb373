"""Revoked certificates: requests on `hexapod/revocation/cmd`, and the answer."""

from typing import Annotated, Final

from pydantic import Field

from schemas.ack import Answer
from schemas.command import Closed

MAX_REVOCATION_BYTES: Final = 16_000
"""Some 125 revoked certificates. The Zenoh files of `certs` allow 16 384 bytes. Copy a longer list as a file."""


class RevocationRequest(Closed):
    """Puts a newer list in force; without a list, queries the list in force."""

    revoked: Annotated[
        str | None, Field(description="newer X.509 CRL (PEM); without it, the list in force is returned")
    ] = None


class RevocationAck(Answer):
    """The answer to a RevocationRequest; null fields are left out of the JSON."""

    number: Annotated[int | None, Field(description="of the list in force; 0: none")] = None
    revoked: Annotated[str | None, Field(description="that list, if the request has none")] = None
