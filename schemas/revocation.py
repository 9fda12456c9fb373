"""Revoked certificates: requests on `hexapod/revocation/cmd`, and the answer."""

from typing import Annotated, Final

from pydantic import Field

from schemas.command import Closed
from schemas.telemetry import Answer

MAX_REVOCATION_BYTES: Final = 16_000
"""Some 125 revoked certificates. The Zenoh files of `certs` allow 16 384 bytes; a longer list goes to the robot as a
file."""


class RevocationRequest(Closed):
    """Puts a newer list in force; without a list, it queries the one in force."""

    revoked: Annotated[
        str | None, Field(description="X.509 CRL as PEM, signed by a CA of this robot, with a higher number")
    ] = None


class RevocationAck(Answer):
    """The answer to a RevocationRequest; null fields are left out of the JSON."""

    number: Annotated[int | None, Field(description="of the list in force; 0: none is")] = None
    revoked: Annotated[str | None, Field(description="the list in force, where the request has none")] = None
