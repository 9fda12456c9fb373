"""The state of a button's check-ins, and when the next is due. Pure: `now_s` is monotonic."""

from typing import Final

SHARE: Final = 4
"""Check-ins within the time that one of them counts: three may be lost on the way."""
CHECK_IN_AGAIN_S: Final = 0.2
"""After one that nobody answered."""
DENIED_S: Final = 1.0
"""After one, or a registration, that was rejected: a registration costs the gateway a proof to check."""
LATE_SHARE: Final = 0.25
"""Of the time that one counts: an answer that takes longer comes late, as the person should know."""


class Known:
    """The state of check-ins, by the replies received."""

    def __init__(self, now_s: float) -> None:
        """The button is registered at `now_s`."""
        self.count = (0, 0)
        """How many are alive, and how many are required, by the latest answer."""
        self.detail = ""
        """The latest reply's own sentence."""
        self.trouble = ""
        """Why the latest was not accepted."""
        self.refused = ""
        """Why no more check-ins are sent. Pressing goes on."""
        self.confirmed_s = now_s
        """When the latest that was accepted was sent."""
        self._answer_s = 0.0
        """How long the latest answer took."""
        self._pause_s: float | None = None
        """After a check-in that was not accepted."""

    def accepted(self, count: tuple[int, int], detail: str, began_s: float, now_s: float) -> None:
        """The gateway counts the check-in that was sent at `began_s`."""
        self.count, self.detail, self._answer_s = count, detail, now_s - began_s
        self.confirmed_s, self.trouble, self._pause_s = began_s, "", None

    def failed(self, trouble: str, *, denied: bool) -> None:
        """It was not accepted: `denied` by the gateway, or not answered."""
        self.trouble, self._pause_s = trouble, DENIED_S if denied else CHECK_IN_AGAIN_S

    def registered(self) -> None:
        """It is registered anew: the next check-in is due in time for that."""
        self._pause_s = None

    def next_s(self, began_s: float, timeout_s: float) -> float:
        """When to check in again, after one that began then and counts for `timeout_s`."""
        return began_s + (timeout_s / SHARE if self._pause_s is None else self._pause_s)

    def silence_s(self, now_s: float) -> float:
        """Since the gateway last took a check-in."""
        return now_s - self.confirmed_s

    def counts(self, now_s: float, timeout_s: float) -> bool:
        """Whether the gateway counts this button, as far as it has answered."""
        return not self.refused and not self.trouble and self.silence_s(now_s) < timeout_s

    def late_s(self, timeout_s: float) -> float | None:
        """How long the latest answer took, if it came late."""
        return self._answer_s if self._answer_s > LATE_SHARE * timeout_s else None


def is_taken(uptime_s: float, registered_s: float, now_s: float) -> bool:
    """Whether another has the name, where a gateway that has been up for so long does not know this button.

    Then it does not register anew: the other has the same certificate, and the two would take the place from each other
    for ever.
    """
    return uptime_s > now_s - registered_s
