"""What the gateway tells its black box.

Nothing here is on the way of a Stop: it is told of a step once all frames of it are written, and before anybody is
answered. A command that is carried out at once is one record with its frame.

Who calls owns the gateway's state, as with the supervisor.
"""

import logging
import os
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from types import TracebackType
from typing import Any, Final, Self

from gateway import __version__
from gateway.errors import GatewayError
from gateway.model.black_box import format as form
from gateway.model.calibration import Calibration, report_of
from gateway.robot.blackbox import paths
from gateway.robot.blackbox.ring import Ring
from gateway.robot.core.events import Request, Transmit
from gateway.robot.protocol import VERSION
from gateway.robot.settings import Settings
from gateway.robot.spi.bus import Sent
from schemas.telemetry import Kind, Mode

LAG_NS: Final = 10_000_000
"""A timer that is later than this is recorded: a Stop would have been late by it."""
CLOCK_NS: Final = 1_000_000_000
ABOUT_NS: Final = 10_000_000_000
"""How often versions and settings are recorded: an incident reaches back as far, and has them among its records."""
FOLLOW_NS: Final = 5_000_000_000
"""An incident takes in what happens up to 5 s after it; what happens meanwhile prolongs it …"""
LONGEST_NS: Final = 30_000_000_000
"""… up to this."""
LANDING_NS: Final = 5_000_000_000
"""What `watchdog.landing_ms` allows at most: the Stops at its end belong to the silence that began it."""
KEPT_BEFORE_OPEN: Final = 200
"""Records of the start, which come before the ring is open: the first Stops do not wait for it."""

INCIDENTS: Final = {
    Kind.WATCHDOG_EXPIRED: "watchdog",
    Kind.LANDING: "landing",
    Kind.ESTOP_ENGAGED: "estop",
    Kind.BUS_FAULT: "bus-fault",
    Kind.OVERFLOW: "overflow",
    Kind.LEASE_TAKEN: "lease-taken",
    Kind.STOPPED_OUTSIDE: "stopped-outside",
    Kind.BUTTON_SILENT: "button",
    Kind.BUTTON_LEFT: "button",
}
"""Events that are kept as incidents, and how their ids end."""
_IF_LEGS_STOP: Final = frozenset({Kind.BUTTON_SILENT, Kind.BUTTON_LEFT})
"""These are incidents only where legs are stopped for them."""
MISTAKE: Final = "mistake"
ACCEPTED: Final = "accepted"
COALESCED: Final = "coalesced"

logger = logging.getLogger(__name__)


Written = tuple[Transmit, Sent]
"""A frame that was written: why, and what the bus says of it."""
Decided = tuple[Request, str]
"""What became of a request (of number 0: it got no further than this), and the verdict."""


class Recorder:
    """The black box, and what it is told. It keeps nothing without a folder, or once that could not be used."""

    def __init__(
        self, settings: Settings, facts: dict[str, Any], clock: Callable[[], int], wall_ns: Callable[[], int]
    ) -> None:
        """`facts` of the start, for whoever reads it."""
        self.incident: str | None = None
        """The id of the latest incident of this run."""
        self.incidents = 0
        """How many this run has begun."""
        self._settings = settings
        self._clock = clock
        self._wall_ns = wall_ns
        self._ring: Ring | None = None
        self._waiting: list[tuple[int, int, bytes]] = []
        self._append: Callable[[int, int, bytes], None] = self._wait
        self._clock_ns = 0  # when the time that people read was recorded last
        self._about_ns = -ABOUT_NS
        self._first_ns = self._until_ns = 0  # what belongs to the latest incident
        self._on = place.folder_of(settings) is not None
        if self._on:
            self._about = form.about(_about(settings, facts))
            self._append(form.START, clock(), form.start(wall_ns(), {"pid": os.getpid(), **facts}))
        else:
            self._append = _forget

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """An error with a sentence is an end in order; any other is for `incidents` to find."""
        if isinstance(error, GatewayError):
            self.ended(str(error))
        self.close()

    def open(self) -> None:
        """Open the ring. Until then, what comes waits. Never raises."""
        folder = place.folder_of(self._settings)
        if folder is None:
            return
        waiting, self._waiting = self._waiting, []
        try:
            self._ring = Ring(place.prepare(folder), place.slots_for(self._settings))
        except OSError as error:
            logger.warning("the black box is off: %s: %s", folder, error.strerror or error)
            self._on, self._append, self.incident = False, _forget, None
            return
        if self._ring.note:
            logger.warning(self._ring.note)
        self._append = self._ring.append
        for kind, ns, rest in waiting:
            self._append(kind, ns, rest)
        self._ring.announce()  # a gateway that is killed between two looks of the watcher is not missed

    def close(self) -> None:
        """No more records."""
        self._append = _forget
        if self._ring is not None:
            self._ring.close()
            self._ring = None

    def step(self, heard: Request | None, written: Sequence[Written], decided: Sequence[Decided]) -> None:
        """A step: the command that it took, if it took one, the frames that it wrote, and what became of commands."""
        if not self._on:
            return
        accepted = 0  # with the only frame of this step: it then needs no Decision
        if len(written) == 1:
            commands = written[0][0].commands
            for request, verdict in decided:
                if verdict == ACCEPTED and commands == (request,):
                    accepted = request.number
        if heard is not None:
            if accepted == heard.number != 0 and len(decided) == 1 and self._carried_out(heard, written[0][1]):
                return
            fields = form.command(heard.number, heard.verb, heard.key, heard.source, heard.sent_ms, heard.targets)
            self._append(form.COMMAND, heard.received_ns, fields)
        for transmit, sent in written:
            late_ns = 0 if transmit.deadline_ns is None else sent.ns - transmit.deadline_ns
            self._append(form.FRAME, sent.ns, form.frame(sent.data, transmit.cause, sent.call_ns, late_ns, accepted))
        for request, verdict in decided:
            number = request.number
            if not number or number != accepted:
                self._append(form.DECISION, self._clock(), form.decision(number, verdict, request.key, request.source))

    def _carried_out(self, heard: Request, sent: Sent) -> bool:
        """Record a command and its frame as one; False: that does not fit, or there is no ring yet."""
        if self._ring is None:
            return False
        body = form.carried_out(
            self._ring.sequence, heard.received_ns, heard.number, heard.verb, heard.key, heard.source, heard.sent_ms,
            heard.targets, sent.data, sent.ns, sent.call_ns,
        )  # fmt: skip
        if body is None:
            return False
        self._ring.put(body)
        return True

    def mode(self, mode: Mode) -> None:
        """The gateway's mode changes."""
        self._append(form.MODE, self._clock(), form.mode(mode))

    def event(
        self,
        kind: Kind,
        source: str | None,
        key: str | None,
        reason: str | None,
        detail: str,
        left_out: int,
        legs: tuple[int, ...] = (),
    ) -> str | None:
        """An event is published; returns the id of the incident that it belongs to, if it is one."""
        now_ns = self._clock()
        self._append(form.EVENT, now_ns, form.event(kind, source, key, reason, detail, left_out))
        what = INCIDENTS.get(kind) if legs or kind not in _IF_LEGS_STOP else None
        return None if what is None else self._happened(what, now_ns)

    def beat(self, lag_ns: int) -> None:
        """The loop turns, ten times a second; its timer was so late."""
        if not self._on:
            return
        now_ns = self._clock()
        if lag_ns > LAG_NS:
            self._append(form.LAG, now_ns, form.number(lag_ns))
        if now_ns - self._clock_ns >= CLOCK_NS:
            self._clock_ns = now_ns
            self._append(form.CLOCK, now_ns, form.number(self._wall_ns()))
        if now_ns - self._about_ns >= ABOUT_NS:
            self._about_ns = now_ns
            self._append(form.ABOUT, now_ns, self._about)

    def mistake(self, detail: str) -> None:
        """An exception that nobody expected ends the service."""
        now_ns = self._clock()
        self._append(form.EVENT, now_ns, form.event(MISTAKE, None, None, None, detail, 0))
        self._happened(MISTAKE, now_ns)

    def calibration(self, calibration: Calibration) -> None:
        """What is in force from now on; to be called at the start, and at each change."""
        if self._ring is None:
            return
        before, now = self._ring.calibration, form.calibration(report_of(calibration))
        if before == now:
            return
        if before:
            ns = self._clock()
            self._append(form.CALIBRATION, ns, before)
            self._append(form.CALIBRATION, ns, now)
        self._ring.calibration = now  # last: who is killed before has it among the records

    def ended(self, why: str) -> None:
        """The last Stops are written."""
        self._append(form.END, self._clock(), form.mode(why))

    def _happened(self, what: str, now_ns: int) -> str | None:
        """What happens within the time that an incident takes in belongs to it, and prolongs it."""
        if not self._on:
            return None
        if self.incident is None or now_ns > min(self._until_ns, self._first_ns + LONGEST_NS):
            wall_ns = self._wall_ns()
            self.incident = incident_id(wall_ns, what)
            self.incidents += 1
            self._first_ns = now_ns
            self._append(form.INCIDENT, now_ns, form.incident(wall_ns, self.incident))
            if self._ring is not None:
                self._ring.announce()
        self._until_ns = max(self._until_ns, now_ns + follow_ns(what))
        return self.incident

    def _wait(self, kind: int, ns: int, rest: bytes) -> None:
        if len(self._waiting) < KEPT_BEFORE_OPEN:
            self._waiting.append((kind, ns, rest))


def follow_ns(what: str) -> int:
    """How long what happens belongs to an incident: `what` is the end of its id, or the kind of a later event."""
    return FOLLOW_NS + LANDING_NS if what == Kind.LANDING else FOLLOW_NS


def incident_id(wall_ns: int, what: str) -> str:
    """Such as 20261122-001233-123-watchdog: the time in UTC to the millisecond, and what happened."""
    seconds, ns = divmod(wall_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y%m%d-%H%M%S}-{ns // 1_000_000:03d}-{what}"


def _about(settings: Settings, facts: dict[str, Any]) -> dict[str, Any]:
    """What a recording has of a gateway, too, under the same names as in its state."""
    return {
        "version": __version__,
        "protocol": VERSION,
        "simulated": facts.get("simulated"),
        "spi": settings.spi.model_dump(mode="json"),
        "watchdog": settings.watchdog.model_dump(mode="json"),
        "limits": settings.limits.model_dump(mode="json"),
    }


def _forget(_kind: int, _ns: int, _rest: bytes) -> None:
    """Where there is no ring."""
