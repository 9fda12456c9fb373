"""What becomes of a request for the lease, or of a button's: the supervisor decides, and here it is answered."""

from gateway.robot.core.events import ButtonRequest, LeaseRequest
from gateway.robot.core.message import Reply
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.settings import ButtonSettings
from schemas import keys
from schemas.button import ButtonAck
from schemas.lease import LeaseAck
from schemas.telemetry import Reason


class LeaseAnswers:
    """Asks the conductor, as owner of the robot's state, and sends the answer after the frames."""

    def __init__(self, conductor: Conductor, ttl_ms: float) -> None:
        self._conductor = conductor
        self._ttl_ms = ttl_ms

    def ask(self, request: LeaseRequest, reply: Reply) -> None:
        """Whoever asks is known, or has said a name that needs no proof."""
        answer = self._conductor.ask(request).lease
        if answer is None:  # the service has ended
            return
        if answer.reason is not None:
            self.reject(request.source, answer.reason, answer.detail or "", reply, holder=answer.holder)
            return
        held = answer.holder is not None
        ack = LeaseAck(
            accepted=True,
            lease=answer.token,
            holder=answer.holder,
            ttl_ms=self._ttl_ms,
            verified=answer.verified if held else None,
        )
        reply(ack.model_dump_json().encode())

    def reject(
        self, source: str | None, reason: Reason, detail: str, reply: Reply, *, holder: str | None = None
    ) -> None:
        """Answer a request that changes nothing, and tell of it."""
        ack = LeaseAck(accepted=False, reason=reason, detail=detail, holder=holder)
        reply(ack.model_dump_json().encode())
        self._conductor.answers.reject_unread(keys.LEASE, source, detail, reason)


class ButtonAnswers:
    """The same of a button's."""

    def __init__(self, conductor: Conductor, settings: ButtonSettings) -> None:
        self._conductor = conductor
        self._settings = settings

    def ask(self, request: ButtonRequest, reply: Reply) -> None:
        """Whoever asks is known, or has a name that needs no proof."""
        answer = self._conductor.ask(request).button
        if answer is None:  # the service has ended
            return
        if answer.reason is not None:
            self.reject(request.source, answer.reason, answer.detail or "", reply)
            return
        ack = ButtonAck(
            accepted=True,
            button=answer.token,
            timeout_ms=self._settings.timeout_ms,
            alive=answer.alive,
            required=self._settings.required,
        )
        reply(ack.model_dump_json().encode())

    def reject(self, source: str | None, reason: Reason, detail: str, reply: Reply) -> None:
        """Answer a request that changes nothing, and tell of it."""
        reply(ButtonAck(accepted=False, reason=reason, detail=detail).model_dump_json().encode())
        self._conductor.answers.reject_unread(keys.BUTTON, source, detail, reason)
