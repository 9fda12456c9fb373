"""An incident in plain sentences: who commanded what, what the gateway decided, what it wrote, with relative times."""

from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final, NamedTuple

from gateway.people.incidents.incidents import kind_of
from gateway.people.incidents.messages import COMMAND_TOPICS, INCIDENT, RECORDER, incident_of
from gateway.people.recordings import Message
from gateway.people.recordings.user_angles import UserAngles, frame_of
from gateway.robot.blackbox.recorder import INCIDENTS, MISTAKE
from gateway.robot.protocol.frames import Frame, Op
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Cause, Kind

TOGETHER_NS: Final = 15_000_000
"""Frames of one cause that follow each other within this are one line. Repeats come 20 ms apart by default."""
FINE_MS: Final = 100.0
"""Times nearer than this to the incident are reported in milliseconds."""

_WHAT: Final = {
    "watchdog": "a leg was silent, and was stopped",
    "button": "too few stop buttons were alive, and all legs were stopped",
    "landing": "a leg was silent, and the robot went to its landing pose",
    "overflow": "messages were lost on the way to the gateway, and legs were stopped for it",
    "lease-taken": "somebody took the lease from its holder, and all legs were stopped",
    "stopped-outside": "stop-servos stopped all legs past the gateway",
    "estop": "somebody requested an emergency stop",
    "bus-fault": "the SPI bus failed",
    "mistake": "a mistake in the gateway ended it",
    "crash": "the gateway ended without a word",
}
"""By how ids end. A list names first what is further down, where several happened."""
_RANKS: Final = {ending: rank for rank, ending in enumerate(_WHAT)}
_EVENTS: Final[dict[object, str]] = {
    Kind.WATCHDOG_EXPIRED: "watchdog",
    Kind.ESTOP_ENGAGED: "emergency stop",
    Kind.ESTOP_RESET: "emergency stop reset",
    Kind.BUS_FAULT: "bus fault",
    Kind.BUS_RECOVERED: "bus recovered",
    Kind.BUS_UNBATCHED: "bus unbatched",
    Kind.OVERFLOW: "overflow",
    Kind.LEASE_TAKEN: "lease taken",
    Kind.STOPPED_OUTSIDE: "stopped outside",
    Kind.BUTTON_SILENT: "button silent",
    Kind.BUTTON_LEFT: "button left",
}
_AT_ZERO: Final[dict[str, str]] = {"watchdog": Kind.WATCHDOG_EXPIRED, "estop": Kind.ESTOP_ENGAGED}
"""Events that are reported after their Stops are written, though what they report came before."""
_ENDINGS: Final[dict[str, str]] = {
    **{str(kind): ending for kind, ending in INCIDENTS.items()},
    MISTAKE: MISTAKE,
    "killed": "crash",
}
"""What an event's kind or a note's `what` is in an incident's id."""
STOOD_NS: Final = 100_000_000
"""A loop that is so late at the time of a stop is the reason for it."""
CAME_NS: Final = 500_000_000
"""What was published while nobody read is there by then."""


class Line(NamedTuple):
    """When (ns since the incident), and what."""

    at_ns: int
    text: str


class NoStoryError(ValueError):
    """These messages are no incident."""


def what(name: str) -> str:
    """What an incident with this id is, in a few words."""
    return _WHAT.get(kind_of(name), kind_of(name))


def story(messages: list[Message]) -> list[str]:
    """The lines to print. Raises NoStoryError."""
    zero = incident_of(messages)
    if zero is None:
        raise NoStoryError("it has no incident")
    name = str(zero.content.get("detail"))
    reported = [each for each in messages if each is not zero]
    lines = [*_commands(reported, zero.time_ns, name), *_rejections(reported, zero.time_ns)]
    lines += [*_events(reported, zero.time_ns, name), *_frames(reported, zero.time_ns), *_notes(reported, zero.time_ns)]
    lines += _landings(reported, zero.time_ns)
    lines.sort(key=lambda line: line.at_ns)
    width = max((len(_at(line.at_ns)) for line in lines), default=0)
    head = f"{name}: {headline(messages)}, at {zero.content.get('time')}"
    timed = (f"{_at(line.at_ns):>{width}}  {line.text}" for line in lines)
    return [_visible(line) for line in (head, *_summary(reported, zero.time_ns), *timed)]


def headline(messages: Iterable[Message]) -> str:
    """The worst that happened in an incident, who asked for it, which legs it stopped, and what else happened.

    Of many messages it holds few. Raises NoStoryError.
    """
    reported: list[Message] = []
    moved_ns = array("q")  # when commands that move came
    for message in messages:
        if _is_command(message):
            if _moves(message):
                moved_ns.append(message.time_ns)
        elif _is_headline(message):
            reported.append(message)
    zero = incident_of(reported)
    if zero is None:
        raise NoStoryError("it has no incident")
    happened = {kind_of(str(zero.content.get("detail"))): ""}
    for message in reported:
        ending = _ENDINGS.get(str(message.content.get("kind") or message.content.get("what")))
        if ending is not None and message.time_ns >= zero.time_ns:
            by = message.content.get("source")
            happened[ending] = happened.get(ending) or (f" ({by})" if by else "")
    if "landing" in happened:
        happened.pop("watchdog", None)  # its Stops are the landing's end
    worst = max(happened, key=lambda ending: _RANKS.get(ending, -1))
    legs = sorted(_stopped_legs(reported, zero.time_ns))
    words = {ending: f"{_WHAT.get(ending, ending)}{by}" for ending, by in happened.items()}
    if legs and "watchdog" in words:
        words["watchdog"] += f": {_named(legs)}"
    first = words.pop(worst)
    if worst in ("watchdog", "landing"):
        first = _stood_still(reported, moved_ns, zero.time_ns) or first
    return _visible("; also: ".join((first, *words.values())))


def _is_headline(message: Message) -> bool:
    if message.topic == keys.FRAME:
        return message.content.get("cause") == Cause.WATCHDOG
    kind = message.content.get("kind") if message.topic == keys.EVENT else None
    note = message.content.get("what") if message.topic == RECORDER else None
    return str(kind) in _ENDINGS or note in (INCIDENT, "lag", "killed")


def _stood_still(notes: Sequence[Message], moved_ns: Sequence[int], zero_ns: int) -> str:
    """Where a leg was silent since nobody read its commands; empty, where the gateway ran."""
    for note in notes:
        if note.content.get("what") != "lag":
            continue
        try:
            lag_ns = round(float(str(note.content.get("detail")).removesuffix(" ms")) * 1e6)
        except ValueError:
            continue
        begun_ns = note.time_ns - lag_ns
        if lag_ns >= STOOD_NS and begun_ns - STOOD_NS <= zero_ns <= note.time_ns + STOOD_NS:
            came = any(begun_ns <= each <= note.time_ns + CAME_NS for each in moved_ns)
            return f"the gateway stood still for {lag_ns / 1e9:.1f} s{'; commands kept coming' if came else ''}"
    return ""


def _visible(line: str) -> str:
    """A sender's text must not control the terminal."""
    if line.isprintable():
        return line
    return "".join(char if char.isprintable() else repr(char)[1:-1] for char in line)


def _at(at_ns: int) -> str:
    """+0.3 ms, -0.251 s."""
    sign = "−" if at_ns < 0 else "+" if at_ns else ""
    at_ms = abs(at_ns) / 1e6
    if 0 < at_ms < FINE_MS:
        return f"{sign}{at_ms:.1f} ms"
    return f"{sign}{at_ms / 1000:.3f} s"


# ---- who commanded


def _is_command(message: Message) -> bool:
    return message.topic in COMMAND_TOPICS and "targets" in message.content


def _legs_of(message: Message) -> list[int]:
    return sorted({target["id"] // 10 for target in message.content["targets"]})


def _moves(message: Message) -> bool:
    return any(target["op"] != "stop" for target in message.content["targets"])


def _taken(message: Message) -> bool:
    return message.content.get("verdict") in (None, "accepted", "coalesced")


def _who(source: Any) -> str:
    return str(source) if source else "somebody without a name"


def _named(legs: list[int]) -> str:
    if legs == list(LEGS):
        return "all six legs"
    return f"leg{'s' if len(legs) > 1 else ''} {', '.join(map(str, legs))}"


def _asked(message: Message, leg: int) -> str:
    """anna, set 90 45 120"""
    parts: list[str] = []
    for target in message.content["targets"]:
        if target["id"] // 10 == leg:
            angle = target.get("angle_deg")
            parts += [target["op"]] if not parts or parts[0] != target["op"] else []
            parts += [] if angle is None else [f"{angle:g}"]
    age = "" if message.content.get("verdict") else ", not decided"
    return f"{_who(message.content.get('source'))}, {' '.join(parts)}{age}"


def _summary(messages: list[Message], zero_ns: int) -> Iterator[str]:
    """One line for each source that commanded before the incident."""
    counts: Counter[str] = Counter()
    legs: dict[str, set[int]] = {}
    for message in messages:
        if _is_command(message) and message.time_ns <= zero_ns and message.content["targets"]:
            who = _who(message.content.get("source"))
            counts[who] += 1
            legs.setdefault(who, set()).update(_legs_of(message))
    for who, count in counts.most_common():
        commands = f"{count} command{'s' if count > 1 else ''}"
        yield f"Before it, {who} sent {commands} for {_named(sorted(legs[who]))}."


def _commands(messages: list[Message], zero_ns: int, name: str) -> Iterator[Line]:
    """The last command of each leg before the incident, and the first that moves one that it stopped."""
    concerned = _stopped_legs(messages, zero_ns) if kind_of(name) == "watchdog" else set(LEGS)
    stopped_ns = _stops_of_legs(messages, zero_ns)
    last: dict[int, Message] = {}
    first: dict[int, Message] = {}
    for message in messages:
        if _is_command(message) and _taken(message):
            if message.time_ns <= zero_ns:
                last |= dict.fromkeys(_legs_of(message), message)
            elif _moves(message):
                again = (leg for leg in _legs_of(message) if stopped_ns.get(leg, message.time_ns) < message.time_ns)
                first = dict.fromkeys(again, message) | first
    for words, found in (("last command of", last), ("first command after it for", first)):
        for leg, message in found.items():
            if leg in concerned or words.startswith("first"):
                yield Line(message.time_ns - zero_ns, f"{words} leg {leg} ({_asked(message, leg)})")
    for message in messages:
        if _is_command(message) and message.topic in (keys.ESTOP, keys.RESET):
            request = "emergency stop" if message.topic == keys.ESTOP else "reset"
            by = _who(message.content.get("source"))
            verdict = "" if _taken(message) else f", rejected: {message.content['verdict']}"
            yield Line(message.time_ns - zero_ns, f"{request} requested by {by}{verdict}")


def _stops_of_legs(messages: Sequence[Message], zero_ns: int) -> dict[int, int]:
    """When each leg had its first Stop since the incident."""
    found: dict[int, int] = {}
    for message in messages:
        frame = frame_of(message.content) if message.topic == keys.FRAME and message.time_ns >= zero_ns else None
        if frame is not None and frame.is_stop:
            found.setdefault(frame.servos[0][0] // 10, message.time_ns)
    return found


def _stopped_legs(messages: Sequence[Message], zero_ns: int) -> set[int]:
    """The legs that the watchdog stopped."""
    legs = set()
    for message in messages:
        if message.topic == keys.FRAME and message.content.get("cause") == Cause.WATCHDOG:
            frame = frame_of(message.content)
            if frame is not None and message.time_ns >= zero_ns:
                legs |= {servo_id // 10 for servo_id, _ in frame.servos}
    return legs


class _Run(NamedTuple):
    """Rejections of one source for one reason, on the same side of the incident."""

    first_ns: int
    last_ns: int
    commands: int


def _rejections(messages: list[Message], zero_ns: int) -> Iterator[Line]:
    runs: dict[tuple[str, str, bool], _Run] = {}
    for message in messages:
        if _is_command(message) and not _taken(message):
            source, reason = message.content.get("source"), message.content["verdict"]
        elif message.topic == RECORDER and message.content.get("what") == "rejected":
            source, reason = message.content.get("source"), message.content.get("detail")
        else:
            continue
        case = _who(source), str(reason), message.time_ns > zero_ns
        found = runs.get(case, _Run(message.time_ns, message.time_ns, 0))
        runs[case] = _Run(found.first_ns, message.time_ns, found.commands + 1)
    for (who, reason, _), run in runs.items():
        if run.commands == 1:
            text = f"a command of {who} is rejected: {reason}"
        else:
            text = f"{run.commands} commands of {who} are rejected until {_at(run.last_ns - zero_ns)}: {reason}"
        yield Line(run.first_ns - zero_ns, text)


# ---- what the gateway did


def _events(messages: list[Message], zero_ns: int, name: str) -> Iterator[Line]:
    for message in messages:
        kind = message.content.get("kind")
        if message.topic != keys.EVENT or kind == Kind.COMMAND_REJECTED:
            continue
        at_ns = message.time_ns - zero_ns
        if kind == _AT_ZERO.get(kind_of(name)) and 0 <= at_ns < TOGETHER_NS:
            at_ns = 0
        source = message.content.get("source")
        by = f" ({source})" if source else ""
        said, detail = str(_EVENTS.get(kind, kind)), str(message.content.get("detail"))
        yield Line(at_ns, f"{detail if detail.startswith(said) else f'{said}: {detail}'}{by}")


def _frames(messages: list[Message], zero_ns: int) -> Iterator[Line]:
    """Stops: those of one cause that follow each other are one line. Frames that move are in the summary's commands."""
    group: list[tuple[Message, Frame]] = []
    for message in messages:
        if message.topic != keys.FRAME:
            continue
        frame = frame_of(message.content)
        if frame is None or not frame.is_stop:
            continue
        if group and (
            message.content.get("cause") != group[-1][0].content.get("cause")
            or message.time_ns - group[-1][0].time_ns > TOGETHER_NS
        ):
            yield _stops(group, zero_ns)
            group = []
        group.append((message, frame))
    if group:
        yield _stops(group, zero_ns)


class _Way:
    """One landing as its frames tell it."""

    def __init__(self, first: Message) -> None:
        self.first = self.last = first
        self.frames = 0
        self.stands: dict[int, int | None] = {}


def _landings(messages: list[Message], zero_ns: int) -> Iterator[Line]:
    """The first and the last frame of each way down, and where it left the legs: nobody commanded these frames."""
    stands: dict[int, int | None] = {}  # of each servo that ever had a frame: its angle, None: stopped
    way: _Way | None = None
    angles = UserAngles()
    for message in messages:
        angles.take(message.topic, message.content)
        if message.topic == keys.EVENT and message.content.get("kind") == Kind.LANDING:
            yield from _reported(way, zero_ns)
            way = None
        frame = frame_of(message.content) if message.topic == keys.FRAME else None
        if frame is None:
            continue
        frame = angles.frame(frame)
        stands |= {servo_id: None if op.op is Op.STOP else op.angle_cdeg for servo_id, op in frame.servos}
        if message.content.get("cause") == Cause.WATCHDOG and not frame.is_stop:
            way = way or _Way(message)
            way.last, way.frames, way.stands = message, way.frames + 1, dict(stands)
    yield from _reported(way, zero_ns)


def _reported(way: _Way | None, zero_ns: int) -> Iterator[Line]:
    if way is not None:
        yield Line(way.first.time_ns - zero_ns, "first frame of the way down")
        count = f"{way.frames} frames" if way.frames > 1 else "one frame"
        yield Line(way.last.time_ns - zero_ns, f"last frame of the way down, after {count}; {_standing(way.stands)}")


def _standing(stands: dict[int, int | None]) -> str:
    """leg 3 at 90 45 120; legs 4, 5 at 90 off off"""
    legs: dict[str, list[int]] = {}
    for leg in LEGS:
        angles = [stands.get(10 * leg + joint) for joint in (1, 2, 3)]
        if angles != [None] * 3:
            words = " ".join("off" if angle is None else f"{angle / 100:g}" for angle in angles)
            legs.setdefault(words, []).append(leg)
    return "; ".join(f"{_named(numbers)} at {words}" for words, numbers in legs.items())


def _stops(group: list[tuple[Message, Frame]], zero_ns: int) -> Line:
    first, last = group[0][0], group[-1][0]
    legs = sorted({servo_id // 10 for _, frame in group for servo_id, op in frame.servos if op.op is Op.STOP})
    cause = str(first.content.get("cause"))
    written = "Stop repeated for" if cause == Cause.REPEAT else "Stop written to"
    until = "" if len(group) == 1 else f", the last at {_at(last.time_ns - zero_ns)}"
    late = first.content.get("late_us")
    after = "" if late is None else f", {late:.0f} µs after the deadline"
    why = "" if cause == Cause.REPEAT else f" ({cause})"
    return Line(first.time_ns - zero_ns, f"{written} {_named(legs)}{why}{after}{until}")


def _notes(messages: list[Message], zero_ns: int) -> Iterator[Line]:
    for message in messages:
        detail = message.content.get("detail")
        match message.content.get("what") if message.topic == RECORDER else None:
            case "start":
                text = f"a gateway starts ({detail})"
            case "end":
                text = f"the gateway ends: {detail}"
            case "mode":
                text = f"mode {detail}"
            case "killed":
                text = "the gateway's last record; its process ended without a word"
            case "stop-servos":
                text = f"stop-servos has written a Stop to each of the six legs, {detail}"
            case "lag":
                text = f"the loop was {detail} late"
            case _:
                continue
        yield Line(message.time_ns - zero_ns, text)
