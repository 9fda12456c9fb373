"""What one page shows of a camera, and whether somebody may drive by it. Pure.

The console decides by what it knows: a picture is shown once the page names it in its request for the next one. So a
page that hangs, or whose picture does not arrive, moves nothing.
"""

from gateway.people.watching.camera import Picture
from gateway.rate_limit import NS_PER_MS, NS_PER_S


class PageCamera:
    """The camera that one page shows. `now_ns` is the console's monotonic clock."""

    def __init__(self, stale_ms: float) -> None:
        """`stale_ms`: an older picture moves nothing; 0: any moves."""
        self._stale_ns = stale_ms * NS_PER_MS
        self._name: str | None = None
        self._taken_ns: int | None = None
        self.sent: Picture | None = None  # the newest one

    def show(self, name: str | None) -> None:
        """Record that the page shows this camera from now on; None: it shows none."""
        if name != self._name:
            self._name, self._taken_ns, self.sent = name, None, None

    def confirm(self, name: str, number: str) -> None:
        """Record that the page shows the picture of this number (`taken_ns`), if that was sent to it last."""
        if name == self._name and self.sent is not None and number == str(self.sent.taken_ns):
            self._taken_ns = self.sent.taken_ns

    def left_s(self, now_ns: int) -> float:
        """Return how long the picture may still be driven by; inf without a camera. For any thread."""
        taken_ns = self._taken_ns
        if self._name is None or not self._stale_ns:
            return float("inf")
        return 0.0 if taken_ns is None else max(0.0, (taken_ns + self._stale_ns - now_ns) / NS_PER_S)

    def bars(self, now_ns: int) -> str:
        """Return why nothing may be driven by the picture, without a full stop; "" if it may. For any thread."""
        taken_ns = self._taken_ns
        if self.left_s(now_ns):
            return ""
        if taken_ns is None:
            return "no picture was shown yet; wait for one, or hide the camera"
        return f"the picture was {(now_ns - taken_ns) / NS_PER_S:.1f} s old"
