"""Who is shut out: what is asked on `hexapod/revocation/cmd`, and the answer."""

from typing import Annotated, Final

from pydantic import Field

from schemas.command import Closed
from schemas.telemetry import Answer

MAX_REVOCATION_BYTES: Final = 16_000
"""Of such a payload: some 125 revoked certificates. Zenoh files of `certs` let 16 384 bytes through; a longer list goes
to the robot as a file."""


class RevocationRequest(Closed):
    """Puts a newer list in force; without a list it asks which one is."""

    revoked: Annotated[
        str | None, Field(description="X.509 CRL as PEM, signed by a CA of this robot, with a higher number")
    ] = None


class RevocationAck(Answer):
    """The answer to a RevocationRequest; fields that say nothing are left out of the JSON."""

    number: Annotated[int | None, Field(description="of the list in force; 0: none is")] = None
    revoked: Annotated[str | None, Field(description="the list in force, where the request has none")] = None
