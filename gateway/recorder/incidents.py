"""Finds the incidents in a ring: what the gateway noted as one, and each end of a gateway that did not end in order."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

from gateway.recorder import format as form
from gateway.recorder.recorder import FOLLOW_NS, INCIDENTS, LONGEST_NS, MISTAKE, incident_id
from schemas import keys
from schemas.telemetry import Cause, Kind

BEFORE_NS: Final = 10_000_000_000
"""How far back an incident reaches."""
CRASH: Final = "crash"
ID: Final = re.compile(r"\d{8}-\d{6}-\d{3}-[a-z-]{1,20}", re.ASCII)
"""What an id looks like: it is the name of a file, too."""
JUST_BEFORE_NS: Final = 1_000_000_000
NEAR_RECORDS: Final = 200
"""What led to an incident is looked for in this time before it was noted, and among so many records on both sides."""
LAST_RECORDS: Final = 20
"""Among these is the latest: a command's time is its arrival, which may be before that of what is recorded earlier."""

_TRIGGERS: Final = frozenset({*INCIDENTS, MISTAKE})

Records = Sequence[form.Record]


@dataclass(frozen=True, slots=True)
class Incident:
    """An incident: what happened, at `zero_ns`, and the time that it takes in, all by the gateway's monotonic clock."""

    name: str
    zero_ns: int
    begin_ns: int
    end_ns: int
    wall_offset_ns: int
    """Add it for the time that people read, ns since 1970."""
    whole: bool
    """Whether nothing can be added to it any more."""
    killed_ns: int | None = None
    """When the gateway's last record was written, if it ended within this time without a word."""

    @property
    def zero_wall_ns(self) -> int:
        return self.zero_ns + self.wall_offset_ns

    def records(self, records: Records) -> list[form.Record]:
        """Those that it takes in, in the order in which they happened."""
        return sorted((each for each in records if self.begin_ns <= each.ns <= self.end_ns), key=lambda each: each.ns)


def kind_of(name: str) -> str:
    """The last part of an incident's id: 20261122-001233-123-watchdog is a watchdog."""
    return name.split("-", 3)[-1]


def find(records: Records, *, written: bool, now_ns: int) -> list[Incident]:
    """The incidents in a ring, oldest first. `written`: a gateway writes to it now."""
    found: list[Incident] = []
    starts = [index for index, record in enumerate(records) if isinstance(record.content, form.Start)]
    bounds = sorted({0, *starts, len(records)})
    for begin, end in pairwise(bounds):
        of_one_run = records[begin:end]
        alive = written and end == len(records)
        noted = _noted(of_one_run, alive=alive, now_ns=now_ns)
        if not alive and not any(isinstance(each.content, form.End) for each in of_one_run[-LAST_RECORDS:]):
            killed_ns = max(each.ns for each in of_one_run[-LAST_RECORDS:])
            if noted and noted[-1].begin_ns <= killed_ns <= noted[-1].end_ns:
                noted[-1] = replace(noted[-1], killed_ns=killed_ns)
            else:
                crash = _crash(of_one_run, killed_ns, now_ns=now_ns)
                noted += [] if crash is None else [crash]
        found += noted
    return found


def _noted(records: Records, *, alive: bool, now_ns: int) -> list[Incident]:
    """What the gateway noted itself."""
    found = []
    for index, record in enumerate(records):
        if isinstance(record.content, form.IncidentBegun) and ID.fullmatch(record.content.incident):
            end_ns = _end(records[index:], record.ns)
            name = record.content.incident
            zero_ns = _zero(records[max(0, index - NEAR_RECORDS) : index + NEAR_RECORDS], record.ns, kind_of(name))
            offset_ns = record.content.wall_ns - record.ns
            whole = not alive or now_ns > end_ns
            found.append(Incident(name, zero_ns, zero_ns - BEFORE_NS, end_ns, offset_ns, whole))
    return found


def _end(following: Records, begun_ns: int) -> int:
    """What happens within the time that an incident takes in prolongs it, as the gateway counts it."""
    end_ns = begun_ns + FOLLOW_NS
    for record in following:
        if record.ns > end_ns:
            break
        if isinstance(record.content, form.EventTold) and record.content.kind in _TRIGGERS:
            end_ns = min(record.ns + FOLLOW_NS, begun_ns + LONGEST_NS)
    return end_ns


def _zero(near: Records, noted_ns: int, kind: str) -> int:
    """When it happened: the watchdog's deadline, or the arrival of the emergency stop; else when it was noted."""
    zero_ns = noted_ns
    for record in near:
        if not noted_ns - JUST_BEFORE_NS < record.ns <= noted_ns:
            continue
        match record.content:
            case form.FrameWritten(cause=Cause.WATCHDOG, late_ns=late_ns) if kind == INCIDENTS[Kind.WATCHDOG_EXPIRED]:
                zero_ns = min(zero_ns, record.ns - late_ns)
            case form.CommandRecord(key=keys.ESTOP) if kind == INCIDENTS[Kind.ESTOP_ENGAGED]:
                zero_ns = min(zero_ns, record.ns)
    return zero_ns


def _crash(records: Records, killed_ns: int, *, now_ns: int) -> Incident | None:
    """The end of a gateway that said nothing of it; None where no record tells the time of day."""
    for record in reversed(records):
        match record.content:
            case form.Start(wall_ns=wall_ns) | form.Clock(wall_ns=wall_ns) | form.IncidentBegun(wall_ns=wall_ns):
                offset_ns = wall_ns - record.ns
                name = incident_id(killed_ns + offset_ns, CRASH)
                end_ns = killed_ns + FOLLOW_NS
                begin_ns, whole = killed_ns - BEFORE_NS, now_ns > end_ns
                return Incident(name, killed_ns, begin_ns, end_ns, offset_ns, whole, killed_ns)
    return None
