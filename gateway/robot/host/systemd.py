"""Notifies systemd that the service is ready, alive or stopping (sd_notify). Does nothing without systemd."""

import os
import signal
import socket
from collections.abc import Mapping
from contextlib import suppress
from typing import Final

NOTIFY_SOCKET: Final = "NOTIFY_SOCKET"
WATCHDOG: Final = "WATCHDOG_USEC"
VARIABLES: Final = (NOTIFY_SOCKET, WATCHDOG, "WATCHDOG_PID")
"""What a child must not inherit, or it could notify in this process's name."""
PINGS_PER_TIMEOUT = 5
"""More than one, so that a late or lost ping does not kill a working service. With WatchdogSec=1 the SPI may fail for
0.7 s (`spi/bus.py`) after the latest one."""

HANGS_AFTER: Final = 3
"""The kernel ends the process after this many watchdog periods without `alive`; systemd does so after one. But
systemd's watchdog ends with a stop request; then systemd waits for TimeoutStopSec=, the time that `stop-servos` may
take on a busy machine."""

ANEW_S: Final = 20.0
"""The time from the old program's last notification to the new program's first. TimeoutStartSec= is 30 s."""


class SystemdNotifier:
    """systemd's notification socket, from `NOTIFY_SOCKET`, and its watchdog's period, from `WATCHDOG_USEC`.

    A `WATCHDOG_PID` of another process means that its watchdog was inherited (sd_watchdog_enabled(3)).
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        path = environment.get(NOTIFY_SOCKET, "")
        self._address = "\0" + path[1:] if path.startswith("@") else path  # "@" stands for the abstract namespace
        self._socket: socket.socket | None = None
        if path:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)  # the loop must not wait for systemd to read
        watched = path and environment.get("WATCHDOG_PID") in (None, str(os.getpid()))
        self._timeout_us = int(environment.get(WATCHDOG, 0)) if watched else 0
        """systemd's watchdog period; 0: there is no watchdog."""
        self.ping_period_s: Final = self._timeout_us / 1e6 / PINGS_PER_TIMEOUT if self._timeout_us else None
        """How often to call `alive`: a fifth of systemd's watchdog period. None: there is no watchdog."""

    def ready(self, status: str) -> None:
        """Report that commands are accepted from now on. Resets systemd's watchdog to the unit's period."""
        period = f"\nWATCHDOG_USEC={self._timeout_us}" if self._timeout_us else ""
        self._send(f"READY=1\nSTATUS={status}{period}")
        self._end_unless_alive()

    def status(self, status: str) -> None:
        """Set the sentence in `systemctl status`. For any thread."""
        self._send(f"STATUS={status}")

    def alive(self) -> None:
        """Report that the loop runs and can own the state. Without it for WATCHDOG_USEC, systemd kills the service."""
        self._send("WATCHDOG=1")
        self._end_unless_alive()

    def stopping(self, *, anew: bool = False) -> None:
        """Report that the service ends, or (`anew`) that the process executes its program again.

        With `anew`, no notification is needed for ANEW_S. Then the kernel, or systemd's watchdog, ends the process.
        """
        if not anew:
            self._send("STOPPING=1")
            self._end_unless_alive()
        elif self._timeout_us:
            self._send(f"RELOADING=1\nSTATUS=starts anew\nWATCHDOG_USEC={round(ANEW_S * 1e6)}\nWATCHDOG=1")
            signal.setitimer(signal.ITIMER_REAL, ANEW_S)  # a new program in this process keeps the timer

    def _end_unless_alive(self) -> None:
        """Have the kernel end this process unless this is called again in time, even if all threads hang."""
        if self._timeout_us:
            signal.setitimer(signal.ITIMER_REAL, self._timeout_us / 1e6 * HANGS_AFTER)

    def _send(self, text: str) -> None:
        if self._socket is not None:
            with suppress(OSError):  # systemd acts by itself when notifications stop
                self._socket.sendto(text.encode(), self._address)
