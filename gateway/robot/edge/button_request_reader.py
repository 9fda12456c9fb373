"""What is asked on the buttons' key: read, and the proof checked, before anybody owns the robot's state for it."""

import datetime as dt
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Final, Protocol

import zenoh
from pydantic import ValidationError

from gateway import certs
from gateway.robot.core.events import ButtonDo, ButtonRequest
from gateway.robot.core.intake import Rejection
from gateway.robot.core.message import Reply
from gateway.robot.edge.proofs import Proofs, fresh_token
from gateway.robot.edge.receiver import Deal
from gateway.robot.edge.request_reader import payload_of, why_unread
from schemas.button import BUTTON_REQUEST, Alive, ButtonAck, Leave, Register
from schemas.lease import Challenge
from schemas.telemetry import Reason

if TYPE_CHECKING:
    from gateway.certs import ProofChecker

_DOES: Final = '"challenge", "register", "alive" or "leave"'


class Answers(Protocol):
    """Who decides; to be called by an owner of the state."""

    def ask(self, request: ButtonRequest, reply: Reply) -> None:
        """Decide, and answer."""

    def reject(self, source: str | None, reason: Reason, detail: str, reply: Reply) -> None:
        """Answer what is rejected already, and tell of it."""


class ButtonRequestReader:
    """Reads requests one by one, on one thread."""

    def __init__(
        self,
        answers: Answers,
        checker: "ProofChecker | None",
        *,
        wall_clock: Callable[[], dt.datetime],
        fresh: Callable[[], str] = fresh_token,
    ) -> None:
        """Without a `checker` names are taken as they are."""
        self._answers = answers
        # `cryptography` is loaded for a gateway with certificates only.
        purpose = None if checker is None else certs.proof.WATCHING
        self._proofs = Proofs(checker, wall_clock, fresh, purpose)

    def note(self, query: zenoh.Query, now_ns: int, reply: Reply) -> Deal:
        """Read one query; what is then to be done with it."""
        payload = payload_of(query)
        if isinstance(payload, Rejection):
            return partial(self._answers.reject, None, payload.reason, payload.detail, reply)
        return self.read(payload, now_ns, reply)

    def read(self, payload: bytes, now_ns: int, reply: Reply) -> Deal:
        """Read one payload, which came at this time; what is then to be done with it."""
        try:
            request = BUTTON_REQUEST.validate_json(payload)
        except ValidationError as error:
            return partial(self._answers.reject, None, *why_unread(error, _DOES), reply)
        match request:
            case Challenge():
                ack = ButtonAck(accepted=True, nonce=self._proofs.challenge(now_ns))
                return partial(reply, ack.model_dump_json().encode())
            case Register():
                denied = self._proofs.why_denied(request.proof, request.do, request.source, now_ns)
                if denied is not None:
                    return partial(self._answers.reject, request.source, Reason.BUTTON_DENIED, denied, reply)
                asked = ButtonRequest(
                    ButtonDo.REGISTER,
                    now_ns,
                    request.source,
                    sent_ms=request.sent_ms,
                    fresh_token=self._proofs.fresh(),
                )
            case Alive():
                asked = ButtonRequest(
                    ButtonDo.ALIVE, now_ns, token=request.button, count=request.count, sent_ms=request.sent_ms
                )
            case Leave():
                asked = ButtonRequest(ButtonDo.LEAVE, now_ns, token=request.button)
        return partial(self._answers.ask, asked, reply)
