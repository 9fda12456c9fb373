"""What becomes of a button's request: the supervisor decides, and here it is answered."""

from gateway.robot.core.events import ButtonRequest
from gateway.robot.core.message import Reply
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.settings import ButtonSettings
from schemas import keys
from schemas.button import ButtonAck
from schemas.telemetry import Reason


class ButtonAnswers:
    """Asks the conductor, as owner of the robot's state, and sends the answer after the frames."""

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
