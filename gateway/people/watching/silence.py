"""How long a gateway has published no state, and what to do then. Pure: `now_ns` is monotonic.

The newest state decides, not the liveliness token: that ends with the gateway's process, but not if the process hangs
or a cable is pulled.
"""

import math
from typing import Final

CHECK_EVERY_S: Final = 0.1
"""How often to check the age of the newest state."""
QUIET_MS: Final = 250.0
"""After this time without a state the gateway is asked for it: it may be delayed."""
SILENT_MS: Final = 1000.0
"""After this time without a state the cause is diagnosed."""
WHY_EVERY_S: Final = 3.0
"""Period of diagnoses: each connects to the robot."""


class Silence:
    """The time since the newest state.

    >>> silence = Silence()
    >>> silence.opened(0)
    >>> silence.received(100_000_000)
    >>> [silence.is_quiet(ms * 1_000_000) for ms in (350, 351)]
    [False, True]
    >>> [silence.is_long(ms * 1_000_000) for ms in (1100, 1101)]
    [False, True]
    """

    def __init__(self) -> None:
        self._since_ns: float | None = None
        self._has_state = False
        self._diagnose_ns = -math.inf

    def opened(self, now_ns: int) -> None:
        """Record that a session is open: the silence counts from now on."""
        self._since_ns = now_ns

    def not_opened(self) -> None:
        """Record that no session opened: the cause may be diagnosed at once."""
        if self._since_ns is None:
            self._since_ns = -math.inf

    def received(self, now_ns: int) -> None:
        """Record a state, published or as an answer."""
        self._since_ns, self._has_state = now_ns, True

    def is_quiet(self, now_ns: int) -> bool:
        """Return whether to ask the gateway for its state."""
        return not self._has_state or self._is_older(now_ns, QUIET_MS)

    def is_long(self, now_ns: int) -> bool:
        """Return whether the gateway counts as silent."""
        return self._is_older(now_ns, SILENT_MS)

    def must_diagnose(self, now_ns: int) -> bool:
        return self.is_long(now_ns) and now_ns >= self._diagnose_ns

    def diagnosed(self, now_ns: int) -> None:
        self._diagnose_ns = now_ns + WHY_EVERY_S * 1e9

    def _is_older(self, now_ns: int, most_ms: float) -> bool:
        return self._since_ns is not None and (now_ns - self._since_ns) / 1e6 > most_ms
