"""A stop button: a program that shows again and again that it is there, and can stop the robot."""

from typing import TYPE_CHECKING, Self

from gateway.errors import DisconnectedError, RejectedError
from schemas.telemetry import Ack

if TYPE_CHECKING:
    from gateway.people.client.blocking import Client
    from schemas.button import ButtonAck


class Button:
    """A stop button for the time of a `with`, alive only as often as the program itself says so.

    Nothing here checks in by itself: a thread that did would vouch for a program that hangs. Call `alive` three times
    within `timeout_ms`, where the program sees that it does what it is there for. At the end it leaves, on purpose.

    >>> with Client(endpoint) as robot, robot.button("kitchen") as button:
    ...     button.alive().alive
    ...     button.press().accepted
    1
    True
    """

    def __init__(self, client: "Client", name: str | None) -> None:
        """See `Client.button`."""
        self._client = client
        self._wanted = name
        self._token: str | None = None
        self._count = 0
        self.name = ""
        """By which name the gateway knows it: the certificate's person, else the one that was asked for."""
        self.timeout_ms = 0.0
        """For so long a check-in counts."""

    def __enter__(self) -> Self:
        """Raises RejectedError where the gateway denies it, DisconnectedError where none answers."""
        self.register()
        return self

    def __exit__(self, *_: object) -> None:
        self.leave()

    def register(self) -> None:
        """Register, or register anew: after the gateway was started again, or this machine slept."""
        self.name = self._client.button_requests.person(self._wanted)
        ack = _granted(self._client.button_requests.register(self._wanted))
        self._token, self._count = ack.button, 0
        self.timeout_ms = ack.timeout_ms or 0.0

    def alive(self) -> "ButtonAck":
        """Check in; the answer says how many are `alive`, and how many are `required`.

        Raises RejectedError: `unknown_button`, where the gateway was started anew or the name has been registered by
        another (`register` again, or do not), or `stale`, where it came too late. DisconnectedError where no answer
        comes within `timeout_ms`: then this button is silent, and the robot stops.
        """
        if self._token is None:
            raise RuntimeError("a button that has left checks in no more; register it again")
        self._count += 1
        timeout_s = self.timeout_ms / 1000 or None
        return _granted(self._client.button_requests.alive(self._token, self._count, timeout_s=timeout_s))

    def press(self) -> Ack:
        """The emergency stop, by the button's name; see `Client.estop`."""
        return self._client.estop(source=self.name or self._wanted)

    def leave(self) -> None:
        """Be none any more; the robot stops if too few remain. One that does not answer notices it by the silence."""
        token, self._token = self._token, None
        if token is not None:
            try:
                self._client.button_requests.leave(token, self.timeout_ms / 1000 or None)
            except DisconnectedError:
                return


def _granted(ack: "ButtonAck") -> "ButtonAck":
    if not ack.accepted:
        raise RejectedError(str(ack.reason), ack.detail or "")
    return ack
