"""Stop buttons: requests on `hexapod/button/cmd`, and the answer."""

from typing import Annotated, Final, Literal

from pydantic import ConfigDict, Field, TypeAdapter

from schemas.command import MAX_NUMBER, Closed, SentMs, Source, hex_digits
from schemas.lease import Challenge, Proof
from schemas.telemetry import Answer, Count

ButtonToken = Annotated[str, hex_digits(": the token of the registration, from the answer that gave it")]
"""A secret: in no report, log line or repr."""


class Register(Closed):
    """Registers a button, replacing an older one of that name."""

    do: Literal["register"]
    source: Source
    proof: Proof | None = None
    sent_ms: SentMs | None = None


class Alive(Closed):
    """Checks in: a person is there, and can press."""

    do: Literal["alive"]
    button: Annotated[ButtonToken, Field(repr=False)]
    count: Annotated[int, Field(ge=0, le=MAX_NUMBER, description="greater than in each check-in before")]
    sent_ms: SentMs | None = None


class Leave(Closed):
    """Ends the registration on purpose."""

    do: Literal["leave"]
    button: Annotated[ButtonToken, Field(repr=False)]


ButtonRequest = Annotated[Challenge | Register | Alive | Leave, Field(discriminator="do")]
"""The payload of a `get` on `hexapod/button/cmd`."""
BUTTON_REQUEST: Final[TypeAdapter[Challenge | Register | Alive | Leave]] = TypeAdapter(
    ButtonRequest, config=ConfigDict(hide_input_in_errors=True)
)


class ButtonAck(Answer):
    """The answer to a ButtonRequest; null fields are left out of the JSON."""

    nonce: str | None = None
    button: Annotated[str | None, Field(repr=False, description="the token that check-ins carry")] = None
    timeout_ms: float | None = None
    alive: Count | None = None
    required: Count | None = None


def signed_text(do: str, source: str, nonce: str) -> bytes:
    """What the proof of a registration signs: ECDSA or RSA (PKCS #1 v1.5) with SHA-256."""
    return f"hexapod-button-1\n{do}\n{source}\n{nonce}".encode()
