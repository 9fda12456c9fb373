"""What is known of a button's check-ins, and when the next is due. `now_s` is monotonic; nothing here reads a clock."""

from typing import Final

SHARE: Final = 4
"""Check-ins within the time that one of them counts: three may be lost on the way."""
AGAIN_S: Final = 0.2
"""After one that nobody answered, or that was rejected."""


class Known:
    """By the answers that have come."""

    def __init__(self, now_s: float) -> None:
        """It is registered now."""
        self._registered_s = now_s
        self.count = (0, 0)
        """How many are alive, and how many are required, by the latest answer."""
        self.trouble = ""
        """Why the latest was not accepted."""
        self.refused = ""
        """Why it is over."""
        self.confirmed_s = now_s
        """When the latest that was accepted was sent."""

    def registered(self, now_s: float) -> None:
        """It is registered anew."""
        self._registered_s = now_s

    def accepted(self, count: tuple[int, int], began_s: float) -> None:
        """The gateway counts the check-in that was sent then."""
        self.count, self.confirmed_s, self.trouble = count, began_s, ""

    def is_taken(self, uptime_s: float, now_s: float) -> bool:
        """Whether another has the name, where a gateway that has been up for so long does not know this button.

        Then it does not register anew: the two would take it from each other for ever, and the robot would stop each
        time.
        """
        return uptime_s > now_s - self._registered_s

    def next_s(self, began_s: float, timeout_s: float) -> float:
        """When to check in again, after one that began then and counts for `timeout_s`."""
        return began_s + (AGAIN_S if self.trouble else timeout_s / SHARE)

    def silence_s(self, now_s: float) -> float:
        """Since the gateway last took a check-in."""
        return now_s - self.confirmed_s

    def counts(self, now_s: float, timeout_s: float) -> bool:
        """Whether the gateway counts this button, as far as it has answered."""
        return not self.refused and not self.trouble and self.silence_s(now_s) < timeout_s
