"""`incidents replay`: decides an incident again from the black box's journal, and compares the frames.

The core is this version's. With other rules (`--set`) the same events meet other decisions: what would have happened.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import groupby
from typing import Any, Final, NamedTuple

from gateway.errors import ConfigError
from gateway.host.settings_reader import Fault, VariableText, dotted, read
from gateway.model import black_box as form
from gateway.model.frames import Op, ServoOp, decode, legs_of
from gateway.people.incidents import ring_reader as rec
from gateway.people.incidents.find import Incident
from gateway.people.incidents.story import relative_time
from gateway.robot.blackbox import journal
from gateway.robot.core.events import (
    Announce,
    BusFailed,
    ButtonRequest,
    ClearErrors,
    Command,
    Completed,
    Cut,
    Effect,
    EmergencyStop,
    Event,
    Feed,
    LeaseRequest,
    Rejected,
    Request,
    RequestAnswer,
    Transmit,
)
from gateway.robot.core.message import Verb
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.service import rules
from gateway.robot.settings import Settings
from gateway.words.text import legs_named
from schemas.words import Cause, Kind, Reason

LEAD_NS: Final = 3_000_000_000
"""The first keyframe is this far before the incident, if one is left: the timeline has the last seconds before it."""
LATE_NS: Final = 5_000_000
"""A timer that is later than this is not this gateway's usual delay."""
BEFORE, AFTER = 20, 10
"""Steps of a test before the incident, and from it on."""

Change = Callable[[Rules], Rules]


# ---- what is left of the journal


@dataclass
class Step:
    """One step: when it was, its record, and the frames that were written (hexadecimal)."""

    ns: int
    instant_ns: int
    record: rec.StepRecord | Command
    written: list[str] = field(default_factory=list)

    def event(self) -> Event:
        """Return the event, as it was before the step. Raises JournalError."""
        if isinstance(self.record, rec.StepRecord):
            return journal.event_of(self.record.event)
        return journal.event_of(journal.plain_event(self.record, mask=_same))


class Journal(NamedTuple):
    """A keyframe and the steps after it; `problem` is why the journal does not reach the incident's end, or ""."""

    keyframe: bytes
    ns: int
    steps: list[Step]
    problem: str


def journal_of(records: rec.Records, incident: Incident, until_ns: int) -> Journal:
    """Return the journal from a keyframe before the incident. Raises ConfigError if there is none."""
    places = [place for place, kind in enumerate(records.kinds) if kind == form.KEYFRAME]
    before = [place for place in places if records.times_ns[place] <= incident.zero_ns]
    early = [place for place in before if records.times_ns[place] <= incident.zero_ns - LEAD_NS]
    found = [_from(records, place, until_ns) for place in (*early[-1:], *before[len(early) :])]
    if not found:
        raise ConfigError(
            f"{incident.name} cannot be played: the black box has no state from before it. It was overwritten, or the "
            "gateway had just started"
        )
    reach = [each for each in found if not each.problem or (each.steps and each.steps[-1].ns >= incident.zero_ns)]
    return (reach or found)[0]


def _from(records: rec.Records, begin: int, until_ns: int) -> Journal:
    keyframe, steps = records[begin], list[Step]()
    problem = ""
    for place in range(begin + 1, len(records)):
        record = records[place]
        step = _step(record)
        problem = _problem(records, place, record)
        if problem or records.kinds[place] == form.START or (step is not None and step.ns > until_ns):
            break
        if step is not None:
            steps.append(step)
        elif isinstance(record.content, rec.FrameWritten) and steps:
            steps[-1].written.append(record.content.data.hex())
    text = keyframe.content.text if isinstance(keyframe.content, rec.Keyframe) else b""
    return Journal(text, keyframe.ns, steps, problem)


def _problem(records: rec.Records, place: int, record: rec.Record) -> str:
    if place in records.gaps:
        return "the records that followed are overwritten or damaged"
    if isinstance(record.content, rec.Gap):
        return "events are missing: a source sent more than the black box has room for"
    if isinstance(record.content, rec.Noted) and record.content.what == "unreadable":
        return f"a record cannot be read ({record.content.detail})"
    return ""


def _step(record: rec.Record) -> Step | None:
    match record.content:
        case rec.StepRecord(instant_ns) as step:
            return Step(record.ns, instant_ns, step)
        case rec.CommandRecord(after_ns=after_ns) as found if after_ns != form.NO_STEP:
            command = Command(found.targets, key=found.key, source=found.source, source_id=found.source_id)
            command.verb, command.number, command.sent_ms = Verb(found.verb), found.number, found.sent_ms
            command.received_ns, now_ns = record.ns, record.ns + after_ns
            command.lease = journal.token_text(found.lease) if found.lease else None
            return Step(now_ns, now_ns - found.waited_ns, command)
    return None


# ---- it is decided again


class Decided(NamedTuple):
    """A step that was decided again: its event, the effects, and the frames in hexadecimal."""

    step: Step
    event: Event
    effects: Sequence[Effect]
    frames: list[str]


def supervisor_of(found: Journal, change: Change | None = None) -> Supervisor:
    """Return the core as it was at the keyframe. Raises ConfigError if this version does not know the format."""
    try:
        return journal.restored(found.keyframe, change or (lambda found: found))
    except rec.FORGED as error:  # JournalError, too
        raise ConfigError(f"it cannot be played: {error}") from error


def decide(supervisor: Supervisor, steps: Iterable[Step], *, wakes: bool = False) -> Iterator[Decided]:
    """Yield each step, decided again. Raises ConfigError for an event that this version, or this state, cannot take.

    `wakes`: with other rules there are other deadlines, so one that no step follows soon is a step, too.
    """
    for step in steps:
        while wakes and supervisor.due_ns is not None and supervisor.due_ns < step.ns - LATE_NS:
            yield _decided(
                supervisor, Step(supervisor.due_ns, supervisor.due_ns, rec.StepRecord(0, {"TimePassed": {}}))
            )
        yield _decided(supervisor, step)


def _decided(supervisor: Supervisor, step: Step) -> Decided:
    try:
        event = step.event()
        effects = supervisor.step(event, step.ns, step.instant_ns)
    except Exception as error:
        raise ConfigError(f"it cannot be played further: {type(error).__name__}: {error}") from error
    return Decided(step, event, effects, journal.frames_of(effects))


def differs(decided: Sequence[Decided]) -> Decided | None:
    """Return the first step whose frames are not those that were written.

    Before a fault, and in the last step of a killed gateway, a part of the frames may have been written, or Stops
    several times.
    """
    for place, each in enumerate(decided):
        ends = place + 1 == len(decided) or type(decided[place + 1].event) is BusFailed
        if each.frames != each.step.written and not (ends and {*each.step.written} <= {*each.frames}):
            return each
    return None


def change_of(about: dict[str, Any], assignments: Sequence[str]) -> Change | None:
    """Return what changes the rules as these settings do (`NAME=VALUE`), or None. Raises ConfigError."""
    tables = {each.name: dict(about.get(each.name, {})) for each in fields(Settings)}
    before = _settings(tables, [])
    if (
        tables["limits"].get("start_stagger_ms")
        == Settings(wire=before.wire, power=before.power).limits.start_stagger_ms
    ):
        del tables["limits"]["start_stagger_ms"]  # by default, it follows from wire and power board
    after, faults = before, list[Fault]()
    for each in assignments:
        name, found, value = each.partition("=")
        section, *path = name.strip().split(".")
        if not found or not path or section not in tables:
            raise ConfigError(f"--set {each}: write NAME=VALUE, with a setting's name: limits.takeover_deg_s=0")
        table: Any = tables[section]
        for part in path[:-1]:
            table = table.setdefault(part, {})
        table[path[-1]] = VariableText(value.strip())
        last, after = after, _settings(tables, faults)
        if not faults and last != after and rules(last) == rules(after):
            raise ConfigError(f"--set {each}: it is no setting of the core, whose rules do not depend on it")
    faults += [fault for fault in after.faults() if fault not in before.faults()]
    if faults:
        raise ConfigError("\n".join(f"--set {dotted(place)}: {sentence}" for place, sentence in dict.fromkeys(faults)))
    old, new = ({each.name: getattr(rules(one), each.name) for each in fields(Rules)} for one in (before, after))
    changes = {name: value for name, value in new.items() if value != old[name]}
    return (lambda found: replace(found, **changes)) if assignments else None


def _settings(tables: dict[str, Any], faults: list[Fault]) -> Settings:
    """Return the settings in these tables. Add the faults of sections, not those between sections."""
    kinds: dict[str, Any] = {each.name: each.type for each in fields(Settings)}
    return Settings(**{name: read(kind, tables[name], faults, (name,)) for name, kind in kinds.items()})


class Played(NamedTuple):
    """What deciding again has found. `problem`: why it ended before the incident's end, or ""."""

    decided: list[Decided]
    lines: list["Explained"]
    same: bool
    frames: int
    """How many frames are equal, before the first difference."""
    result: str
    problem: str


def play(found: Journal, zero_ns: int, change: Change | None = None) -> Played:
    """Decide the journal's steps again. Raises ConfigError if this version does not know the keyframe."""
    decided, problem = list[Decided](), found.problem
    supervisor = supervisor_of(found, change)
    try:
        decided.extend(decide(supervisor, found.steps, wakes=change is not None))
    except ConfigError as error:
        problem = str(error)
    different = differs(decided)
    frames = sum(len(each.step.written) for each in decided[: decided.index(different) if different else None])
    if different is None:
        result = f"Decided again from {relative_time(found.ns - zero_ns)}: the same {_count(frames, 'frame')}."
    else:
        at, equal = relative_time(different.step.ns - zero_ns), _count(frames, "equal frame")
        written, now = _frames_in_words(different.step.written), _frames_in_words(different.frames)
        result = f"Different at {at}, after {equal}. Written: {written}. Decided now: {now}."
    return Played(decided, timeline(decided, zero_ns), different is None, frames, result, problem)


def seconds(text: str) -> int:
    """Return the ns of a time as the timeline has it: `0.25`, `-1.5 s`, `+20.4 ms`. Raises ConfigError."""
    found = re.fullmatch(r"([+−-]?)(\d{1,6}(?:\.\d{1,9})?) ?(s|ms)?", text.strip(), re.ASCII)
    if found is None:
        raise ConfigError(f"--until {text}: write seconds after the incident, such as 0.25 or -1.5")
    ns = round(float(found[2]) * (1e6 if found[3] == "ms" else 1e9))
    return ns if found[1] in ("", "+") else -ns


# ---- the timeline

RULES: Final[dict[str, str]] = {
    **dict.fromkeys((Kind.WATCHDOG_EXPIRED, Cause.WATCHDOG), "Watchdog"),
    **dict.fromkeys((Kind.LANDING, Reason.LANDING), "Landing"),
    **dict.fromkeys((Kind.ESTOP_ENGAGED, Kind.ESTOP_RESET, Reason.ESTOPPED, Cause.ESTOP), "Emergency stop"),
    **dict.fromkeys((Kind.BUS_FAULT, Kind.BUS_RECOVERED, Reason.BUS_FAULT, Kind.CONTROLLER_SILENT), "Bus fault"),
    **dict.fromkeys((Kind.CONTROLLER_RESTARTED, Kind.CONTROLLER_RETURNED), "Bus fault"),
    **dict.fromkeys((Kind.STOPPING, Reason.STOPPING, Cause.SHUTDOWN, Kind.STOPPED_OUTSIDE), "End"),
    **dict.fromkeys((Reason.NOT_HOLDER, Reason.NO_LEASE), "Lease"),
    **{kind: "Lease" for kind in (*Kind, *Reason) if kind.startswith("lease_")},
    **{kind: "Buttons" for kind in (*Kind, *Reason) if "button" in kind and kind != Kind.OFF_BUTTON},
    **{kind: "Power" for kind in (*Kind, *Reason) if "power" in kind},
    **dict.fromkeys((Kind.OFF_BUTTON, Kind.SERVO_DRAWS, Kind.SERVO_SILENT), "Power"),
    **dict.fromkeys((Kind.BATTERY_LOW, Kind.FALLEN), "Measurements"),
    **dict.fromkeys((Kind.CALIBRATED, Reason.JOINT_LIMIT, Reason.INVALID), "Calibration"),
    Kind.SOURCE_CHANGED: "Take-over and first frame",
    Reason.WHOLE_ROBOT: "The whole robot",
    Reason.SERVO_STOPPED: "Start before Set",
    Reason.STALE: "Bursts without `sent_ms`",
    Reason.OVERFLOW: "Order",
    Cause.STARTUP: "Start",
    Cause.REPEAT: "Legs at rest",
    Cause.COMMAND: "Rate limit",
}
"""The name in docs/interface.md of the rule that decides an event's kind, a rejection or a frame."""


class Explained(NamedTuple):
    """A line of the timeline: from when to when, what happened, the rule that decided, and what it did."""

    ns: int
    """After the incident, as `until_ns`."""
    until_ns: int
    event: str
    rule: str
    done: str


def timeline(decided: Iterable[Decided], zero_ns: int) -> list[Explained]:
    """Return a line for each step that decided something, and one for each run of setpoints and time."""
    found: list[Explained] = []
    for ordinary, steps in groupby(decided, _is_ordinary):
        run = list(steps)
        found += _ordinary(run) if ordinary else map(_line, run)
    return [each._replace(ns=each.ns - zero_ns, until_ns=each.until_ns - zero_ns) for each in found if each.done]


def _is_ordinary(each: Decided) -> bool:
    """Return whether a step only carries out setpoints, repeats Stops, or does nothing."""
    return all(
        type(effect) is Completed
        or (type(effect) is RequestAnswer and effect.reason is None)
        or (type(effect) is Transmit and (not effect.frame.is_stop or effect.cause is Cause.REPEAT))
        for effect in each.effects
    )


def _ordinary(run: list[Decided]) -> Iterator[Explained]:
    commands = [each.event for each in run if isinstance(each.event, Command)]
    legs = legs_of(servo_id for each in commands for servo_id in each.servo_ids)
    frames = [effect for each in run for effect in each.effects if isinstance(effect, Transmit)]
    moves = [effect.cause for effect in frames if not effect.frame.is_stop]
    sent = [f"{who}: {_count(number, 'command')}" for who, number in Counter(map(_who, commands)).items()]
    event = f"{' and '.join(sent)} for {legs_named(legs)}" if sent else "time passed"
    rule = RULES[Cause.COMMAND if moves or sent else Cause.REPEAT]
    repeats = len(frames) - len(moves)
    done = _count(len(moves), "frame") if sent or moves else ""
    done += f"{', ' * bool(done)}{_count(repeats, 'repeated Stop')}" if repeats else ""
    yield Explained(run[0].step.ns, run[-1].step.ns, event, "Landing" if Cause.WATCHDOG in moves else rule, done)


def _count(number: int, what: str) -> str:
    return f"{number or 'no'} {what}{'' if number == 1 else 's'}"


def _line(each: Decided) -> Explained:
    announced = [effect for effect in each.effects if isinstance(effect, Announce)]
    rejected = [effect for effect in each.effects if isinstance(effect, Rejected)]
    refused = [effect for effect in each.effects if isinstance(effect, RequestAnswer) and effect.reason is not None]
    noes: list[Rejected | RequestAnswer] = [*rejected, *refused]
    frames = [effect for effect in each.effects if isinstance(effect, Transmit)]
    decisive: list[str | None] = [*(effect.kind for effect in announced), *(effect.reason for effect in noes)]
    decisive += [each.cause for each in frames if not (each.frame.is_stop and each.cause is Cause.COMMAND)]
    rule = next((RULES[str(name)] for name in decisive if name in RULES), "")
    why = [effect.detail or effect.done for effect in announced if effect.kind is not Kind.LEGS_STOPPED]
    why += [f"rejected, {effect.reason}: {effect.detail}" for effect in noes]
    power = [_words(effect) for effect in each.effects if isinstance(effect, Cut | Feed | ClearErrors)]
    done = "; ".join([*dict.fromkeys(why), *_frames(frames), *dict.fromkeys(power)])
    return Explained(each.step.ns, each.step.ns, _event(each.event), rule or "Power" * bool(power), done)


def _frames(frames: Sequence[Transmit]) -> Iterator[str]:
    for cause in dict.fromkeys(each.cause for each in frames):
        stops = legs_of(
            servo for each in frames if each.cause is cause and each.frame.is_stop for servo, _ in each.frame.servos
        )
        moves = [each for each in frames if each.cause is cause and not each.frame.is_stop]
        if stops:
            yield f"{'Stops' if len(stops) > 1 else 'Stop'} ({cause}) for {legs_named(stops)}"
        if moves:
            yield f"{_count(len(moves), 'frame')} for {legs_named(legs_of(each.frame.leg * 10 for each in moves))}"


def _frames_in_words(frames: Iterable[str]) -> str:
    return "; ".join(_asked(decode(bytes.fromhex(each)).servos) for each in frames) or "no frame"


def _who(event: Any) -> str:
    return event.source or "somebody without a name"


def _event(event: Event) -> str:
    words = _words(event)
    match event:
        case Command():
            words = "messages were lost" if event.lost else f"{_who(event)}: {_asked(event.targets)}"
        case EmergencyStop() | Request() | LeaseRequest() | ButtonRequest():
            words = f"{_who(event)}: {words} {getattr(event, 'do', '')}".rstrip()
        case BusFailed():
            words = f"{words}: {event.detail}"
    return words


def _words(event: Event | Effect) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", " ", type(event).__name__).lower()


def _asked(targets: Iterable[tuple[int, ServoOp]]) -> str:
    """`set leg 3 to 90 45 120, stop servo 41`"""
    parts = []
    for leg, named in groupby(targets, lambda target: target[0] // 10):
        ops = list(named)
        angles = " ".join(f"{op.angle_cdeg / 100:g}" for _, op in ops if op.op is not Op.STOP)
        word = "/".join(dict.fromkeys(op.op.name.lower() for _, op in ops))
        which = f"leg {leg}" if len(ops) == 3 else "servo " + " ".join(str(servo_id) for servo_id, _ in ops)
        parts.append(f"{word} {which}{' to ' * bool(angles)}{angles}")
    return ", ".join(parts)


def told(lines: Sequence[Explained]) -> list[str]:
    """Return the lines as text."""
    times = [(relative_time(line.ns), relative_time(line.until_ns)) for line in lines]
    width = max((len(at) for at, _ in times), default=0)
    events = [f"{line.event}{f', until {end}' * (end != at)}" for line, (at, end) in zip(lines, times, strict=True)]
    return [
        f"{at:>{width}}  {' → '.join(part for part in (event, line.rule, line.done) if part)}"
        for line, event, (at, _) in zip(lines, events, times, strict=True)
    ]


# ---- a test

_TEST: Final = '''"""{title}

Written by `hexapod-gateway incidents replay ID --as-test FILE`: the core's state, events, and the frames that follow.
"""

from gateway.robot.blackbox.journal import event_of, frames_of, restored

STATE = {state!r}
STEPS = [
    # ns, ns of its instant, event, frames
{steps}
]


def test_the_same_frames_are_written() -> None:
    supervisor = restored(STATE)
    for now_ns, instant_ns, event, frames in STEPS:
        assert frames_of(supervisor.step(event_of(event), now_ns, instant_ns)) == frames, now_ns
'''


def as_test(incident: Incident, title: str, supervisor: Supervisor, decided: Sequence[Decided]) -> str:
    """Return a test with the steps around the incident. `supervisor` has the state before the first of `decided`."""
    zero = next((place for place, each in enumerate(decided) if each.step.ns >= incident.zero_ns), len(decided))
    begin = max(0, zero - BEFORE)
    for _ in decide(supervisor, [each.step for each in decided[:begin]]):
        pass
    state = journal.Keyframes(supervisor, mask=_same).take().decode()
    steps = [
        f"    {(each.step.ns, each.step.instant_ns, journal.plain_event(each.step.event(), mask=_same), each.frames)},"
        for each in decided[begin : zero + AFTER]
    ]
    return _TEST.format(title=title, state=state, steps="\n".join(steps))


def _same(token: Any) -> Any:
    """Keep a token: those of a journal are replaced already."""
    return token
