"""A stop button: a program that shows again and again that it is there, and can stop the robot."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, Self

from gateway.errors import DisconnectedError, RejectedError
from gateway.people.client.requests import ButtonRequests
from schemas.telemetry import Ack, Reason

if TYPE_CHECKING:
    from schemas.button import ButtonAck

LIFE: Final = 600
"""Times `timeout_ms` until it registers anew: the gateway lets a registration's clock fall behind by a quarter of that
time, and a bad crystal (200 ppm) loses half of that quarter meanwhile."""
REGISTERED_WITHIN: Final = 0.5
"""Of `timeout_ms`, for both questions of a registration. How late later check-ins are is judged by its delay, so one
that somebody on the way has held back for longer does not count."""
REGISTRATION_TRIES: Final = 3
"""The first of a program also loads what signs."""


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

    def __init__(self, requests: ButtonRequests, estop: Callable[[str | None], Ack], name: str | None) -> None:
        """See `Client.button`. @private"""
        self._requests = requests
        self._estop = estop
        self._wanted = name
        self._token: str | None = None
        self._count = 0
        self._ends_s = 0.0
        """When the registration has lived long enough, monotonic."""
        self.registered_s = 0.0
        """When it was, monotonic. @private"""
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
        """Register, or register anew: after the gateway was started again, or this machine slept.

        Raises RejectedError (`stale`) where the answers take longer than half of `timeout_ms`.
        """
        self.name = self._requests.person(self._wanted)
        for _ in range(REGISTRATION_TRIES):
            began_s = time.monotonic()
            ack = _granted(self._requests.register(self._wanted))
            self._token, self._count = ack.button, 0
            self.timeout_ms = ack.timeout_ms or 0.0
            self.registered_s = self._ends_s = time.monotonic()
            if self.registered_s - began_s <= REGISTERED_WITHIN * self.timeout_ms / 1000:
                self._ends_s += LIFE * self.timeout_ms / 1000
                return
        raise RejectedError(Reason.STALE, "to register takes longer than half of what a check-in counts for")

    def alive(self) -> "ButtonAck":
        """Check in; the answer says how many are `alive`, and how many are `required`. Registers anew now and then.

        Raises RejectedError: `unknown_button`, where the gateway was started anew or the name has been registered by
        another (`register` again, or do not), or `stale`, where it came too late. DisconnectedError where no answer
        comes within `timeout_ms`: then this button is silent, and the robot stops.
        """
        if self._token is None:
            raise RuntimeError("a button that has left checks in no more; register it again")
        if time.monotonic() >= self._ends_s:
            self._renew()
        self._count += 1
        timeout_s = self.timeout_ms / 1000 or None
        return _granted(self._requests.alive(self._token, self._count, timeout_s=timeout_s))

    def _renew(self) -> None:
        """Register anew in time. Where it is denied, such as for too many proofs a second, the older one goes on."""
        try:
            self.register()
        except RejectedError as error:
            if error.reason != Reason.BUTTON_DENIED:
                raise
            self._ends_s = time.monotonic() + LIFE / 10 * self.timeout_ms / 1000

    def press(self) -> Ack:
        """The emergency stop, by the button's name; see `Client.estop`."""
        return self._estop(self.name or self._wanted)

    def leave(self) -> None:
        """Be none any more; the robot stops if too few remain. @private"""
        token, self._token = self._token, None
        if token is not None:
            try:
                self._requests.leave(token, self.timeout_ms / 1000 or None)
            except DisconnectedError:
                return  # it notices the silence


def _granted(ack: "ButtonAck") -> "ButtonAck":
    if not ack.accepted:
        raise RejectedError(str(ack.reason), ack.detail or "")
    return ack
