"""Watches for certificates that expire, routers that cannot be reached and addresses that do not exist yet.

A background thread checks, and reports to the log and systemd. No finding stops the service. Zenoh itself reports none.
"""

import datetime as dt
import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import zenoh

from gateway import certs
from gateway.endpoints import host_and_port
from gateway.errors import ConfigError
from gateway.host.realtime import PAGE_PRIORITY, prefer_thread
from gateway.robot.zenoh_io.late_addresses import LateAddresses
from gateway.zenoh_config import Expiry, connect_endpoints, first_expiry, listen_endpoints
from schemas.telemetry import CertificateReport

LINKS_PERIOD_S: Final = 1.0
GRACE_S: Final = 3.0
"""Time to connect to a router at the start. Zenoh retries at least once a second."""
CLOCK_S: Final = 3600.0
"""Period of the check for expiry. The clock may be set after the start."""

logger = logging.getLogger(__name__)


class Upkeep:
    """Runs from construction until `close`."""

    def __init__(
        self,
        session: zenoh.Session,
        config: zenoh.Config,
        status: Callable[[str], None],
        wall_clock: Callable[[], dt.datetime],
        late: LateAddresses,
    ) -> None:
        """`status` shows a sentence in `systemctl status`, instead of the previous one. `late` are late endpoints."""
        self._session = session
        self._late = late
        self._dials = connect_endpoints(config)
        self._dialled_ports = _ports(self._dials) - _ports(listen_endpoints(config))
        self._config = config
        self._status = status
        self._wall_clock = wall_clock
        self._begun_s = time.monotonic()
        self._clock_due_s = self._begun_s
        self._reached: bool | None = None
        self._fault: str | None = None
        self._shown = "takes commands"
        self.first_expiry = first_expiry(config)
        """The first expiry of the certificates loaded at the start. A renewed one is used from the next start on."""
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="upkeep", daemon=True)
        self._thread.start()

    @property
    def certificate(self) -> CertificateReport | None:
        """`first_expiry` as the state reports it."""
        first = self.first_expiry
        return None if first is None else CertificateReport(file=first.file.name, expires=first.end)

    def close(self) -> None:
        """End the thread. Blocks, so do not call it on the loop's thread."""
        self._closed.set()
        self._thread.join()

    def _run(self) -> None:
        prefer_thread(PAGE_PRIORITY)
        with suppress(zenoh.ZError):  # the session was closed
            while True:
                self._check(time.monotonic())
                often = self._dials or self._late.missing
                if self._closed.wait(
                    LINKS_PERIOD_S if often else max(LINKS_PERIOD_S, self._clock_due_s - time.monotonic())
                ):
                    return

    def _check(self, now_s: float) -> None:
        self._check_links(now_s)
        self._late.check()
        if now_s >= self._clock_due_s:
            self._clock_due_s = now_s + CLOCK_S
            fault, self._fault = self._fault, self._expiry_fault()
            if self._fault and self._fault != fault:  # once a day, from WARN_DAYS before the expiry
                logger.warning(self._fault)
        missing = f"; does not listen on {', '.join(self._late.missing)} yet" if self._late.missing else ""
        unreached = f"; {', '.join(self._dials)} is not reached" if self._reached is False else ""
        status = f"takes commands{missing}{unreached}{f'; {self._fault}' if self._fault else ''}"
        if status != self._shown:
            self._shown = status
            self._status(status)

    def _check_links(self, now_s: float) -> None:
        if not self._dials:
            return
        reached = any(_ports([str(link.dst)]) & self._dialled_ports for link in self._session.info.links())
        if reached is self._reached or (not reached and now_s - self._begun_s < GRACE_S):
            return
        self._reached = reached
        where = ", ".join(self._dials)
        if reached:
            logger.info("%s is reached", where)
        else:
            logger.warning(
                "%s is not reached: until it is, nobody behind it can command this robot or watch it. The gateway "
                "keeps trying; `sudo hexapod-gateway check` finds the cause",
                where,
            )

    def _expiry_fault(self) -> str | None:
        first, now = self.first_expiry, self._wall_clock()
        if first is None or (soon := certs.expires_soon(first.file.name, first.end, now)) is None:
            return None
        result = "then nobody can connect" if now < first.end else "nobody can connect (is this clock right?)"
        return f"{soon}: {result}; {self._remedy(first)}"

    def _remedy(self, first: Expiry) -> str:
        restart = "restart the service"
        try:
            now_there = first_expiry(self._config)
            if now_there is not None and now_there.end > first.end:
                return f"a newer one is there: {restart}, which then uses it"
            found = certs.folder.describe(first.file)
        except ConfigError as error:
            return str(error)
        return f"{certs.how_to_renew(first.file.name, found.role, found.name)}, and {restart}"


def _ports(endpoints: list[str]) -> set[str]:
    return {port for _, port in map(host_and_port, endpoints) if port.isdecimal()}
