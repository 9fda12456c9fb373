"""Finds the incidents in a ring: what the gateway noted as one, and each end of a gateway that did not end in order."""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Final

from gateway.model import black_box as form
from gateway.people.incidents import ring_reader as rec
from schemas import keys
from schemas.words import Cause, Kind

BEFORE_NS: Final = 10_000_000_000
"""An incident includes this time before its zero."""
CRASH: Final = "crash"
JUST_BEFORE_NS: Final = 1_000_000_000
NEAR_RECORDS: Final = 200
"""The cause of an incident is searched this long before it was noted, and this many records on both sides."""
LAST_RECORDS: Final = 20
"""The latest time is among these records: a command's time is its arrival, before it was recorded."""

_TRIGGERS: Final = frozenset({*form.INCIDENT_NAMES, form.MISTAKE})
_TELL_THE_TIME: Final = frozenset({form.START, form.CLOCK, form.INCIDENT})


@dataclass(frozen=True, slots=True)
class Incident:
    """An incident: what happened at `zero_ns`, and the time around it, by the gateway's monotonic clock."""

    name: str
    zero_ns: int
    begin_ns: int
    end_ns: int
    wall_offset_ns: int
    """Add it to a monotonic time to get ns since 1970."""

    def wall_ns(self, ns: int) -> int:
        """Return ns since 1970 at monotonic time `ns`, at least 0: a machine without a clock begins in 1970."""
        return max(0, ns + self.wall_offset_ns)


def time_of(name: str) -> datetime:
    """Return the UTC time in an incident's id, in whole seconds. Raises ValueError if `name` begins with no time."""
    return datetime.strptime(name[:15], "%Y%m%d-%H%M%S").replace(tzinfo=UTC)


def kind_of(name: str) -> str:
    """Return the last part of an incident's id: `watchdog` of 20261122-001233-123-watchdog."""
    return name.split("-", 3)[-1]


def find(records: rec.Records) -> list[Incident]:
    """Return the incidents of a ring, oldest first."""
    found: list[Incident] = []
    for run in _runs(records):
        noted, killed_ns = _noted(records, run), _killed_ns(records, run)
        found += noted
        if killed_ns is not None and not (noted and noted[-1].begin_ns <= killed_ns <= noted[-1].end_ns):
            found += _crash(records, run, killed_ns)
    return found


def killed(records: rec.Records) -> dict[int, int]:
    """Return when gateways that did not record their end wrote their last records, by the place of the next one's."""
    return {run.stop: ns for run in _runs(records) if (ns := _killed_ns(records, run)) is not None}


def _runs(records: rec.Records) -> Iterable[range]:
    """Return the places of each gateway's records."""
    starts = [index for index, kind in enumerate(records.kinds) if kind == form.START and index]
    return itertools.starmap(range, itertools.pairwise((0, *starts, len(records))))


def _killed_ns(records: rec.Records, run: range) -> int | None:
    """Return when a gateway wrote its last record; None if it runs, recorded its end, or its last records are lost."""
    last = run[-LAST_RECORDS:]
    runs = records.written and run.stop == len(records)
    if runs or run.stop in records.gaps or any(records.kinds[index] == form.END for index in last):
        return None
    return max((records.times_ns[index] for index in last), default=None)


def _noted(records: rec.Records, run: range) -> list[Incident]:
    """Return the incidents that the gateway noted itself. Later events prolong one, as in the gateway."""
    found: list[Incident] = []
    longest_ns = 0
    for index in run:
        if records.kinds[index] not in {form.INCIDENT, form.EVENT}:
            continue
        match (record := records[index]).content:
            case rec.WallTime(wall_ns, name):
                near = range(max(run.start, index - NEAR_RECORDS), min(run.stop, index + NEAR_RECORDS))
                zero_ns = _zero(records, near, record.ns, kind_of(name))
                end_ns, longest_ns = record.ns + form.follow_ns(kind_of(name)), record.ns + form.LONGEST_INCIDENT_NS
                found.append(Incident(name, zero_ns, zero_ns - BEFORE_NS, end_ns, wall_ns - record.ns))
            case rec.EventPublished(kind) if kind in _TRIGGERS and found and record.ns <= found[-1].end_ns:
                end_ns = min(max(found[-1].end_ns, record.ns + form.follow_ns(kind)), longest_ns)
                found[-1] = replace(found[-1], end_ns=end_ns)
    return found


def _zero(records: rec.Records, near: range, noted_ns: int, kind: str) -> int:
    """Return its time: the watchdog's deadline, or the emergency stop's arrival; otherwise when it was noted."""
    zero_ns = noted_ns
    for index in near:
        if not noted_ns - JUST_BEFORE_NS < records.times_ns[index] <= noted_ns:
            continue
        record = records[index]
        match record.content:
            case rec.FrameWritten(cause=Cause.WATCHDOG, late_ns=late_ns) if (
                late_ns and kind == form.INCIDENT_NAMES[Kind.WATCHDOG_EXPIRED]  # frames of a landing have no deadline
            ):
                zero_ns = min(zero_ns, record.ns - late_ns)
            case rec.CommandRecord(key=keys.ESTOP) if kind == form.INCIDENT_NAMES[Kind.ESTOP_ENGAGED]:
                zero_ns = min(zero_ns, record.ns)
    return zero_ns


def _crash(records: rec.Records, run: range, killed_ns: int) -> Iterator[Incident]:
    """Yield the end of a gateway that did not record it, if a record shows the time of day."""
    for index in reversed(run):
        if records.kinds[index] in _TELL_THE_TIME:
            record = records[index]
            if isinstance(record.content, rec.Start | rec.WallTime):
                offset_ns = record.content.wall_ns - record.ns
                name = form.incident_id(killed_ns + offset_ns, CRASH)
                yield Incident(name, killed_ns, killed_ns - BEFORE_NS, killed_ns + form.FOLLOW_NS, offset_ns)
                return
