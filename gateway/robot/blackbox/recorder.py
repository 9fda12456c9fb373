"""Writes the gateway's records into the black box, up to a share for each source. For the owner of the state.

A flood must not overwrite the time before an incident. So all sources together may make as many records a second as
the ring has room for (`rings.client_records_a_second`), and one source SHARE of that. Omitted records are counted.

Recording delays no Stop: a step is recorded after all its frames are written, and before its commands are answered. A
step is one record, which has its event and what became of the requests that it ended, and one for each frame. A command
that one call carries out at once shares its record with its frames.
"""

import logging
import os
import struct
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict
from functools import partial
from operator import attrgetter
from pathlib import Path
from threading import Lock
from typing import Any, Final
from zlib import compress

from pydantic_core import to_json

from gateway import __version__
from gateway.files import durable
from gateway.host.directories import state_directory
from gateway.host.worker import Worker
from gateway.model import black_box as form
from gateway.model import elkapod
from gateway.model.black_box import ACCEPTED, CARRIED_OUT, COPIED_SHARE, MOST_COPIES, SENT_NOT, copies_of, copy_path
from gateway.model.black_box import sender as sender_of
from gateway.model.calibration import RobotCalibration, report_of
from gateway.model.elkapod import Measured
from gateway.model.frames import Frame, bytes_of
from gateway.rate_limit import MOST_SOURCES, NS_PER_S
from gateway.robot.blackbox import ring as rings
from gateway.robot.blackbox.journal import Keyframes, plain_event, token_number
from gateway.robot.blackbox.ring import RecordRing
from gateway.robot.core.events import (
    Announce,
    ButtonRequest,
    Command,
    EmergencyStop,
    Event,
    LeaseRequest,
    Request,
    Result,
    Transmit,
)
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.settings import Settings
from gateway.robot.spi import Sent
from schemas.words import Cause, Kind, Mode

CHUNK: Final = 4096
"""Records copied at a time: half a megabyte of memory."""
MOST_WAITING: Final = 4096
"""Records that wait for the ring: a disk that hangs must not fill the memory."""
CLOSE_S: Final = 1.0  # mutants accepted (Step): a bound of something quicker
"""Longest wait for a copy; one of the largest ring takes about 10 ms."""
OPENING_S: Final = 0.2  # mutants accepted (Step): likewise
"""Longest wait of the end for the ring's opening, which takes milliseconds: a service ends within a second."""


def copy(ring: Path, newest: int) -> None:
    """Copy the COPIED_SHARE of a ring's records up to `newest`, and remove the oldest copies. Logs why it failed."""
    staged = durable.staged_for(ring)
    try:
        staged.unlink(missing_ok=True)  # from a killed process
        with ring.open("rb") as source, durable.replacing(copy_path(ring, newest), staged):
            head = source.read(form.HEADER_BYTES)
            slots = form.slots_of(head, os.fstat(source.fileno()).st_size)
            count = slots // COPIED_SHARE
            with open(staged, "xb", opener=partial(os.open, mode=0o600)) as target:
                target.write(form.new_header(count))
                number = max(1, newest + 1 - count)  # mutants accepted (Step): no record is 0
                while number <= newest:
                    run = min(CHUNK, newest + 1 - number, slots - number % slots)
                    begin = form.HEADER_BYTES + number % slots * form.SLOT
                    target.write(os.pread(source.fileno(), run * form.SLOT, begin))
                    number += run
                target.truncate(form.file_bytes(count))
        for old in copies_of(ring)[:-MOST_COPIES]:
            old.unlink()
    except (OSError, form.DamagedRingError) as error:
        logger.warning("the time before this incident is not copied, and is lost after a minute: %s", error)


SHARE: Final = 0.75
"""One source's part of the records that messages may make. A stream of six legs at the limit makes a quarter of them
with `plain` framing, half with `length-prefixed`."""


class RecordShares:
    """Admits records of each source, and of all together, up to one second's at once. Counts the omitted ones.

    Allowances that are used up begin anew once they are a second old. So a source within its rate lacks no record.
    """

    def __init__(self, a_second: int) -> None:  # mutants accepted (Step): long ago
        """Admit `a_second` records of all sources."""
        self._of_all, self._of_one = a_second, int(a_second * SHARE)
        self._begun_ns = self._used = 0
        self._used_by: dict[str | None, int] = {}
        self._omitted = Counter[str | None]()

    def admit(self, source: str | None, count: int, now_ns: int) -> bool:
        """Return whether this source's next `count` records may be written. If not, count them."""
        used = self._used + count
        of_source = self._used_by.get(source, 0) + count
        if used > self._of_all or of_source > self._of_one:
            return self._renewed(source, count, now_ns)
        self._used = used
        self._used_by[source] = of_source
        return True

    def _renewed(self, source: str | None, count: int, now_ns: int) -> bool:
        """Begin a new second if one is over, and return whether the records are admitted now."""
        if now_ns - self._begun_ns >= NS_PER_S:
            self._begun_ns, self._used = now_ns, 0
            self._used_by.clear()
            return self.admit(source, count, now_ns)
        known = source in self._omitted or len(self._omitted) < MOST_SOURCES
        self._omitted[source if known else None] += count
        return False

    def left_out(self) -> list[tuple[str | None, int]]:
        """Return each source with omitted records since the last call, and their number."""
        found, self._omitted = self._omitted, Counter()
        return list(found.items())


LAG_NS: Final = 10_000_000
"""A timer later than this is recorded, since it would have delayed a Stop as much."""
CLOCK_NS: Final = 1_000_000_000
ABOUT_NS: Final = 5_000_000_000
"""Period of records of version, settings and calibration. So also a short copy contains one."""
KEYFRAME_NS: Final = 5_000_000_000
"""Period of keyframes. So also a short copy contains one, and a replay begins that long before an incident."""
MEASURED_NS: Final = 100_000_000
"""Shortest time between records of measurements: 1 % of the ring, and a fall takes longer."""

EVENT_SLOTS: Final = 3
"""Slots of an event with a long sentence."""
LIMITED: Final = (
    frozenset({Kind.COMMAND_REJECTED, Kind.SOURCE_CHANGED, Kind.LEGS_STOPPED, Kind.OVERFLOW, Kind.CALIBRATED})
    | {kind for kind in Kind if kind.startswith(("lease_", "button_"))}
) - {Kind.LEASE_EXPIRED, Kind.BUTTON_SILENT}
"""Events that clients can cause at any rate. Each kind has its own limit, so that a flood of one hides no other: two
clients that compete for a leg hide no takeover."""
_BY_CLIENTS: Final = frozenset({*LIMITED, Kind.ESTOP_ENGAGED, Kind.ESTOP_RESET})
"""Events that clients can cause at any rate. Events of the gateway's own rules are always recorded."""

_IF_LEGS_STOP: Final = frozenset({Kind.BUTTON_SILENT, Kind.BUTTON_LEFT})
"""Incidents only if they stop legs."""
logger = logging.getLogger(__name__)

Written = tuple[Transmit, Sent]
"""A written frame: the effect behind it, and the bus's data."""
Taken = tuple[Event, int, int]
"""A step's event, when it was taken, and when its instant began, both in ns."""
FROM_CLIENTS: Final = (Request, EmergencyStop, LeaseRequest, ButtonRequest)
"""Events that clients can cause at any rate."""


_pack_carried_out: Final = form.CARRIED_OUT_HEAD.pack
_data_of: Final = attrgetter("data")


def _ended(decided: Sequence[Result]) -> list[tuple[int, str]]:
    return [(request.number, verdict) for request, verdict, _ in decided]


class Recorder:
    """The black box. Without a folder, or if the ring cannot be opened, it records nothing."""

    def __init__(
        self, settings: Settings, facts: dict[str, Any], clock: Callable[[], int], wall_ns: Callable[[], int]
    ) -> None:
        """`facts` go into the start's record. `clock` is monotonic, `wall_ns` the wall clock, both in ns."""
        self.incident: str | None = None
        """The id of the latest incident of this run."""
        self.incidents = 0
        self._settings = settings
        self._clock = clock
        self._wall_ns = wall_ns
        self._ring: RecordRing | None = None
        self._shares = RecordShares(rings.client_records_a_second(settings))
        self._waiting: list[tuple[int, int, bytes]] = []
        """Records before the ring is open, for which the first Stops do not wait."""
        self._append: Callable[[int, int, bytes], None] = self._keep
        """Writes a record: its type, its time (ns), and its content."""
        self._opening = Lock()
        """Held while the ring is being opened."""
        self._event: Event | None = None
        """Of the latest step."""
        self._keyframes: Keyframes | None = None
        self._keyframe_ns = 0
        self._gap = False
        """Whether the journal lacks an event since the latest keyframe."""
        self._clock_ns = 0  # of the latest record of the wall clock  # mutants accepted (Step): long ago
        self._about_ns = clock()
        self._calibration = b""
        self._measured_ns = -MEASURED_NS
        # mutants accepted (Step): an incident sets them
        self._first_ns = self._until_ns = 0  # begin and end of the latest incident
        self._copy_due = self._runs = False
        self._ran = True  # since the latest copy
        self._copied_ns = -form.FOLLOW_NS
        self._folder = state_directory(settings.state.path)
        """None: the black box is off, or closed."""
        about = {"version": __version__, "protocol": settings.protocol, "simulated": facts.get("simulated")}
        sections = {name: asdict(getattr(settings, name)) for name in form.SETTINGS}
        self._about = form.fields({**about, "wire": {"name": settings.wire.name}, **sections})
        self._append(form.START, clock(), form.fields(wall_ns(), {"pid": os.getpid(), **facts}))
        self._append(form.ABOUT, self._about_ns, self._about)

    def open(self, owner: AbstractContextManager[None]) -> None:
        """Open the ring, and write the records that wait for it. Waits for the disk, then for the state. Never raises.

        `owner` is the state's lock.
        """
        with self._opening:
            if self._folder is None:
                return
            self._path = self._folder
            try:
                self._path = rings.prepare(self._folder)
                ring = RecordRing(self._path, rings.slots_for(self._settings))
            except OSError as error:
                logger.warning("the black box is off: %s: %s", self._path, error.strerror or error)
                with owner:
                    self._folder = self.incident = None
                return
            if ring.note:
                logger.warning(ring.note)
            self._worker = Worker("copy incident")
            with owner:
                for each in self._waiting:
                    ring.append(*each)
                self._waiting.clear()
                self._ring, self._append = ring, ring.append

    def close(self) -> None:
        """Close the ring; later records are discarded. Waits OPENING_S at most for one that is being opened."""
        opened = self._opening.acquire(timeout=OPENING_S)
        self._folder = None
        if opened:
            self._opening.release()  # an opening that only begins now finds nothing to open
        if self._ring is not None:
            self._copy(self._ring, self._copied_ns + form.FOLLOW_NS)
            self._worker.close(CLOSE_S)
            self._append = self._keep  # which keeps nothing any more
            self._ring.close()
            self._ring = None

    def follow(self, supervisor: Supervisor) -> None:
        """Write keyframes of this supervisor from now on. Call it between two steps."""
        self._keyframes = Keyframes(supervisor)
        self._take_keyframe(self._clock())

    def _take_keyframe(self, now_ns: int) -> None:
        if self._keyframes is not None:
            self._append(form.KEYFRAME, now_ns, compress(self._keyframes.take(), 1))
            self._keyframe_ns, self._gap = now_ns, False

    def carried_out(self, command: Command, now_ns: int, instant_ns: int, frames: Sequence[Frame], sent: Sent) -> None:
        """Record the step of a command that these frames of one call have completed, as one record."""
        self._event = command
        if self._folder is None:
            return  # mutants accepted (Forget): nothing is kept all the same
        if not self._shares.admit(command.source, len(frames), now_ns):
            self._lacks(now_ns)
            return
        lease, sent_ms = command.lease, command.sent_ms
        data, targets = b"".join(map(_data_of, frames)), b""
        if frames is not command.frames:  # they have the servos' own angles
            targets = bytes_of(command.targets)
        try:
            head = _pack_carried_out(
                sent.ns,
                sent.call_ns,
                len(data),
                command.number,
                SENT_NOT if sent_ms is None else sent_ms,
                now_ns - command.received_ns,
                now_ns - instant_ns,
                0 if lease is None else token_number(lease),
                not targets,
            )
        except struct.error:  # it waited for more than four seconds
            self._taken(command, now_ns, instant_ns, ((command.number, ACCEPTED),))
            for frame in frames:
                self._append(form.FRAME, sent.ns, form.frame(frame.data, Cause.COMMAND, sent.call_ns))
            return
        sender = sender_of(command.verb, command.key, command.source, command.source_id)
        self._append(CARRIED_OUT, command.received_ns, head + data + targets + sender)

    def step(self, taken: Taken, written: Sequence[Written], decided: Sequence[Result]) -> None:
        """Record a step: its event, the requests that it ended, and its frames.

        If the sender has used up its share, the step is omitted. Steps that no message causes, such as the watchdog's,
        are always recorded.
        """
        event, now_ns, instant_ns = taken
        self._event = event
        if self._folder is None:
            return  # mutants accepted (Forget): nothing is kept all the same
        if type(event) is Command and written and decided == [(event, ACCEPTED, "")] and not event.lost:
            first = written[0][1]  # mutants accepted (Step): those of one call have the same time
            if all(transmit.commands == (event,) and sent.ns == first.ns for transmit, sent in written):
                self.carried_out(event, now_ns, instant_ns, [transmit.frame for transmit, _ in written], first)
                return
        sender = event if isinstance(event, FROM_CLIENTS) else decided[0][0] if decided else None
        # mutants accepted (Step): without a command, one source is decided about
        if sender is not None and not self._shares.admit(sender.source, 1 + len(written), now_ns):
            self._lacks(now_ns)
            return
        self._taken(event, now_ns, instant_ns, _ended(decided))
        for transmit, sent in written:
            late_ns = 0 if transmit.deadline_ns is None else sent.ns - transmit.deadline_ns
            fields = form.frame(transmit.frame.data, transmit.cause, sent.call_ns, late_ns)
            self._append(form.FRAME, sent.ns, fields)

    def _taken(self, event: Event, now_ns: int, instant_ns: int, ended: Sequence[tuple[int, str]]) -> None:
        """Record an event of a step, and the requests that the step ended."""
        if isinstance(event, Request) and not (type(event) is Command and event.lost):
            after_ns, waited_ns = now_ns - event.received_ns, now_ns - instant_ns
            if (
                type(event) is Command
                and event.rejected is None
                and 0 <= after_ns < form.NO_STEP
                and 0 <= waited_ns < form.NO_STEP
            ):
                token = 0 if event.lease is None else token_number(event.lease)
                self._command(event, after_ns, waited_ns, token, ended)
                return
            self._command(event)
        self._append(form.STEP, now_ns, form.step(instant_ns, to_json(plain_event(event)), ended))

    def _command(
        self,
        one: Request,
        after_ns: int = form.NO_STEP,
        waited_ns: int = 0,
        lease: int = 0,
        ended: Sequence[tuple[int, str]] = (),
    ) -> None:
        """Record a request, with its step if it has one."""
        of_step = after_ns, waited_ns, lease, ended
        fields = form.command(
            one.number, one.verb, one.key, one.source, one.sent_ms, one.targets, one.source_id, *of_step
        )
        self._append(form.COMMAND, one.received_ns, fields)

    def broke(self, taken: Taken) -> None:
        """Record the event that broke the gateway, unless its step is recorded."""
        if taken[0] is not self._event:
            self.step(taken, (), ())

    def _lacks(self, now_ns: int) -> None:
        """Record that the journal lacks a step, once for each keyframe."""
        if not self._gap:
            self._gap = True
            self._append(form.GAP, now_ns, b"")

    def request(self, request: Request | None, decided: Sequence[Result] = ()) -> None:
        """Record a request that takes no step of its own, and its outcome. None: it could not be read."""
        sender = request or decided[0][0]
        if self._folder is None or not self._shares.admit(sender.source, 1, now_ns := self._clock()):
            return
        if request is not None:
            self._command(request, ended=_ended(decided))
        for unread, reason, _ in decided if request is None else ():
            self._append(form.NOTE, now_ns, form.fields("rejected", reason, unread.source, unread.key))

    def mode(self, mode: Mode) -> None:
        """Record a change of the gateway's mode. Emergency stops and resets in turns use up a share."""
        now_ns = self._clock()
        self._runs = mode is Mode.ACTIVE
        self._ran |= self._runs
        if self._shares.admit(None, 1, now_ns):
            self._append(form.NOTE, now_ns, form.fields("mode", mode))

    def event(self, event: Announce, source: str | None, left_out: int) -> str | None:
        """Record a published event. Return the id of the incident that it begins or belongs to, or None."""
        now_ns = self._clock()
        what = form.INCIDENT_NAMES.get(event.kind) if event.legs or event.kind not in _IF_LEGS_STOP else None
        always = event.kind not in _BY_CLIENTS or (what is not None and self._begins(now_ns))
        if always or self._shares.admit(source, EVENT_SLOTS, now_ns):
            fields = form.fields(event.kind, source, event.key, event.reason, event.detail, left_out)
            self._append(form.EVENT, now_ns, fields)
        return None if what is None else self._happened(what, now_ns)

    def beat(self, lag_ns: int) -> None:  # mutants accepted (Gt_GtE, GtE_Gt): equal times
        """Record a timer that was `lag_ns` late, and the periodic records. Call it ten times a second."""
        if self._folder is None:
            return  # mutants accepted (Forget): nothing is kept all the same
        now_ns = self._clock()
        if self._ring is not None:
            self._copy(self._ring, now_ns)
        if lag_ns > LAG_NS:
            self._append(form.NOTE, now_ns, form.fields("lag", f"{lag_ns / 1e6:.1f} ms"))
        if now_ns - self._clock_ns >= CLOCK_NS:
            self._clock_ns = now_ns
            self._append(form.CLOCK, now_ns, form.fields(self._wall_ns()))
            for source, count in self._shares.left_out():
                self._append(form.NOTE, now_ns, form.fields("left_out", f"{count} records", source))
        if now_ns - self._keyframe_ns >= KEYFRAME_NS:
            self._take_keyframe(now_ns)
        if now_ns - self._about_ns >= ABOUT_NS:
            self._about_ns = now_ns
            self._append(form.ABOUT, now_ns, self._about)
            if self._calibration:
                self._append(form.CALIBRATION, now_ns, self._calibration)

    def _copy(self, ring: RecordRing, now_ns: int) -> None:
        """Have the time before an incident copied, if that is due. Returns at once.

        A flood of emergency stops makes one copy: the next one needs servos that have run since, and FOLLOW_NS.
        """
        if self._copy_due and now_ns - self._copied_ns >= form.FOLLOW_NS:
            self._copy_due, self._ran, self._copied_ns = False, self._runs, now_ns
            self._worker.do(partial(copy, self._path, ring.sequence - 1))

    def measured(self, values: Measured, now_ns: int) -> None:
        """Record the robot's measurements, at most once in MEASURED_NS."""
        if self._folder is not None and now_ns - self._measured_ns >= MEASURED_NS:
            self._measured_ns = now_ns
            self._append(form.MEASURED, now_ns, elkapod.answer(values))

    def mistake(self, detail: str) -> None:
        """Record an unexpected exception, which ends the service."""
        now_ns = self._clock()
        self._append(form.EVENT, now_ns, form.fields(form.MISTAKE, None, None, None, detail, 0))
        self._happened(form.MISTAKE, now_ns)

    def calibration(self, calibration: RobotCalibration) -> None:
        """Record the calibration in force. Call it at the start, and at each change."""
        self._calibration = report_of(calibration).model_dump_json().encode()
        self._append(form.CALIBRATION, self._clock(), self._calibration)

    def ended(self, why: str) -> None:
        """Record the end, after the last Stops."""
        self._append(form.END, self._clock(), form.fields("end", why))

    def _begins(self, now_ns: int) -> bool:  # mutants accepted (Gt_GtE): equal times
        """Return whether an incident now would be a new one, and not prolong the latest."""
        return self.incident is None or now_ns > min(self._until_ns, self._first_ns + form.LONGEST_INCIDENT_NS)

    def _happened(self, what: str, now_ns: int) -> str | None:
        """Begin an incident or prolong the latest. Return its id."""
        if self._folder is None:
            return None
        if self._begins(now_ns):
            wall_ns = self._wall_ns()
            self.incident = form.incident_id(wall_ns, what)
            self.incidents += 1
            self._first_ns = now_ns
            self._append(form.INCIDENT, now_ns, form.fields(wall_ns, self.incident))
        self._copy_due |= self._ran
        self._until_ns = max(self._until_ns, now_ns + form.follow_ns(what))
        return self.incident

    def _keep(self, kind: int, ns: int, rest: bytes) -> None:
        """Keep a record until the ring is open."""
        if self._folder is not None and len(self._waiting) < MOST_WAITING:
            self._waiting.append((kind, ns, rest))
