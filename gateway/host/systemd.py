"""What the service tells its manager (systemd's sd_notify protocol); silent where nobody asked."""

import os
import socket
from collections.abc import Mapping

PINGS_PER_TIMEOUT = 4
"""One late or lost ping must not kill a service that works."""


class SystemdNotifier:
    """The service manager's notification socket, as `NOTIFY_SOCKET` and `WATCHDOG_USEC` name it."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        path = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + path[1:] if path.startswith("@") else path  # "@" stands for the abstract namespace
        self._socket: socket.socket | None = None
        if path:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)  # a manager that does not read must not hold the loop
        self._ping_period_s = _ping_period_s(environment) if path else None

    @property
    def ping_period_s(self) -> float | None:
        """How often the manager wants to hear `alive`, with room to spare; None: it does not watch."""
        return self._ping_period_s

    def ready(self, status: str) -> None:
        """Commands are taken from now on."""
        self._tell(f"READY=1\nSTATUS={status}")

    def alive(self) -> None:
        """The loop turns. Not heard for WATCHDOG_USEC, the manager kills the service and has the servos stopped."""
        self._tell("WATCHDOG=1")

    def stopping(self) -> None:
        """The service ends."""
        self._tell("STOPPING=1")

    def close(self) -> None:
        """Nothing more is told."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _tell(self, text: str) -> None:
        if self._socket is None:
            return
        try:
            self._socket.sendto(text.encode(), self._address)
        except OSError:
            # Nothing to be done about it here: a manager that hears nothing acts by itself.
            return


def _ping_period_s(environment: Mapping[str, str]) -> float | None:
    for_whom = environment.get("WATCHDOG_PID", "")
    timeout_us = environment.get("WATCHDOG_USEC", "")
    if not timeout_us.isdecimal() or int(timeout_us) == 0 or (for_whom and for_whom != str(os.getpid())):
        return None
    return int(timeout_us) / 1e6 / PINGS_PER_TIMEOUT
