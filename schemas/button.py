"""Stop buttons: requests on `hexapod/button/cmd`, and the answer."""

from typing import Annotated, Final, Literal

from pydantic import ConfigDict, Field, TypeAdapter

from schemas.ack import Answer
from schemas.command import MAX_NUMBER, Closed, SentMs, Source, hex_digits
from schemas.lease import Challenge, Proof
from schemas.report import Count

ButtonToken = Annotated[str, hex_digits("token of the registration, a secret")]
"""A secret: in no report, log line or repr."""


class Register(Closed):
    """Registers a button, replacing an older one of that name."""

    do: Annotated[Literal["register"], Field(description="get a nonce, become a button, check in, or leave")]
    source: Source
    proof: Annotated[Proof | None, Field(description="if the gateway has a CA (Behaviour *Proof*)")] = None
    sent_ms: SentMs | None = None


class Alive(Closed):
    """Checks in: a person is there, and can press."""

    do: Literal["alive"]
    button: Annotated[ButtonToken, Field(repr=False)]
    count: Annotated[int, Field(ge=0, le=MAX_NUMBER, description="greater than in each check-in before")]
    sent_ms: SentMs | None = None


class Leave(Closed):
    """Ends the registration."""

    do: Literal["leave"]
    button: Annotated[ButtonToken, Field(repr=False)]


ButtonRequest = Annotated[Challenge | Register | Alive | Leave, Field(discriminator="do")]
"""The payload of a `get` on `hexapod/button/cmd`."""
BUTTON_REQUEST: Final[TypeAdapter[Challenge | Register | Alive | Leave]] = TypeAdapter(
    ButtonRequest, config=ConfigDict(hide_input_in_errors=True)
)


class ButtonAck(Answer):
    """The answer to a ButtonRequest; null fields are left out of the JSON."""

    nonce: Annotated[str | None, Field(description="of a challenge, if a proof is needed")] = None
    button: Annotated[str | None, Field(repr=False, description="token for check-ins, a secret")] = None
    timeout_ms: Annotated[float | None, Field(description="the setting: check in three times in this time")] = None
    alive: Annotated[Count | None, Field(description="as in the state")] = None
    required: Annotated[Count | None, Field(description="the setting")] = None


def signed_text(do: str, source: str, nonce: str) -> bytes:
    """Return what the proof of a registration signs: ECDSA or RSA (PKCS #1 v1.5) with SHA-256."""
    return f"hexapod-button-1\n{do}\n{source}\n{nonce}".encode()
