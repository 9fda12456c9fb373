"""A stop button: a program that regularly shows the gateway that it is alive, and can stop the robot."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, Self

from gateway.errors import DisconnectedError, RejectedError
from gateway.people.client.requests import ButtonRequests
from schemas.telemetry import Ack, Reason

if TYPE_CHECKING:
    from schemas.button import ButtonAck

LIFE: Final = 600
"""A button registers again after this many `timeout_ms`. A bad crystal (200 ppm) drifts by an eighth of `timeout_ms` in
that time, and the gateway allows a quarter."""
REGISTERED_WITHIN: Final = 0.5
"""The part of `timeout_ms` for both queries of a registration, whose delay is the reference for late check-ins."""
REGISTRATION_TRIES: Final = 3
"""More than one, since a program's first registration also imports `cryptography`."""


class Button:
    """A stop button for the time of a `with`. The program itself checks in, by `alive`.

    A thread would check in for a program that hangs. Call `alive` three times within `timeout_ms`, from the code whose
    progress counts. The end of the `with` ends the registration, which is no failure.

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
        """When to register again (monotonic seconds)."""
        self.name = ""
        """The button's name at the gateway: the certificate's person, else the name that the program chose."""
        self.timeout_ms = 0.0
        """How long a check-in counts, in milliseconds."""

    def __enter__(self) -> Self:
        """Register. Raises RejectedError if the gateway denies it, DisconnectedError if none answers."""
        self.register()
        return self

    def __exit__(self, *_: object) -> None:
        self.leave()

    def register(self) -> None:
        """Register. Call it again after the gateway was restarted or this machine slept.

        Raises RejectedError (`stale`) if the answers take longer than half of `timeout_ms`.
        """
        self.name = self._requests.person(self._wanted)
        for _ in range(REGISTRATION_TRIES):
            began_s = time.monotonic()
            ack = self._requests.register(self._wanted).or_raise()
            self._token, self._count = ack.button, 0
            self.timeout_ms = ack.timeout_ms or 0.0
            registered_s = self._ends_s = time.monotonic()
            if registered_s - began_s <= REGISTERED_WITHIN * self.timeout_ms / 1000:
                self._ends_s += LIFE * self.timeout_ms / 1000
                return
        raise RejectedError(Reason.STALE, "registering takes longer than half the time that a check-in counts")

    def alive(self) -> "ButtonAck":
        """Check in. The answer counts the buttons `alive` and `required`. Registers again every 600 `timeout_ms`.

        Raises RejectedError: `unknown_button` if the gateway was restarted or another program has registered the name
        (`register` takes it back), `stale` if the check-in was late. Raises DisconnectedError if no answer comes within
        `timeout_ms`: then this button counts as silent, and the robot stops.
        """
        if self._token is None:
            raise RuntimeError("a button that has left cannot check in; register it again")
        if time.monotonic() >= self._ends_s:
            try:
                self.register()
            except RejectedError as error:  # denied, for too many proofs a second: the old registration stays
                if error.reason != Reason.BUTTON_DENIED:
                    raise
                self._ends_s = time.monotonic() + LIFE / 10 * self.timeout_ms / 1000
        self._count += 1
        timeout_s = self.timeout_ms / 1000 or None
        return self._requests.alive(self._token, self._count, timeout_s=timeout_s).or_raise()

    def press(self) -> Ack:
        """Engage the emergency stop in the button's name; see `Client.estop`."""
        return self._estop(self.name or self._wanted)

    def leave(self) -> None:
        """End the registration; the robot stops if too few buttons remain. @private"""
        token, self._token = self._token, None
        if token is not None:
            try:
                self._requests.leave(token, self.timeout_ms / 1000 or None)
            except DisconnectedError:
                return  # the registration expires
