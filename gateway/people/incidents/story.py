"""An incident in plain sentences: who commanded what, what the gateway decided, what it wrote, with relative times."""

from array import array
from bisect import bisect
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final, NamedTuple

from gateway.model.black_box import INCIDENT_NAMES, MISTAKE
from gateway.model.frames import Frame, Op
from gateway.people.incidents.find import kind_of
from gateway.people.incidents.messages import INCIDENT, RECORDER, RecordedMessage
from gateway.people.ros2.commanded import UserAngles
from gateway.words.text import legs_named, visible
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Telemetry
from schemas.words import Cause, Kind

_TOGETHER_NS: Final = 15_000_000
"""Frames of one cause that follow each other within this are one line. Repeats come 20 ms apart by default."""
FINE_MS: Final = 100.0
"""Times nearer than this to the incident are reported in milliseconds."""

WORDS: Final = {
    "watchdog": "a leg was silent, and was stopped",
    "fallen": "the body tilted too far, and all legs were stopped",
    "button": "too few stop buttons were alive, and all legs were stopped",
    "landing": "a leg was silent, and the robot went to its landing pose",
    "overflow": "messages were lost on the way to the gateway, and legs were stopped for it",
    "lease-taken": "somebody took the lease from its holder, and all legs were stopped",
    "stopped-outside": "stop-servos stopped all legs past the gateway",
    "estop": "somebody requested an emergency stop",
    "bus-fault": "the wire to the servos failed",
    "off-button": "somebody pressed the robot's off button, and all legs were stopped",
    "controller-silent": "the controller fell silent, and all legs were stopped",
    "controller-restarted": "the controller may have restarted, and all legs were stopped",
    "power-fault": "the power board reported a fault",
    "servo-draws": "a servo that was stopped still drew current",
    "power-unconfirmed": "the power board did not confirm a Stop",
    "mistake": "a mistake in the gateway ended it",
    "crash": "the gateway ended without a word",
}
"""Words by the end of an id. If several happened, later rows come first."""
_RANKS: Final = {ending: rank for rank, ending in enumerate(WORDS)}
_EVENTS: Final[dict[object, str]] = {
    Kind.WATCHDOG_EXPIRED: "watchdog",
    Kind.ESTOP_ENGAGED: "emergency stop",
    Kind.ESTOP_RESET: "emergency stop reset",
}
"""Events that have another name than their kind."""
_AT_ZERO: Final[dict[str, str]] = {"watchdog": Kind.WATCHDOG_EXPIRED, "estop": Kind.ESTOP_ENGAGED}
"""Events that are published after their Stops are written, although they happened before."""
_ENDINGS: Final[dict[str, str]] = {
    **{str(kind): ending for kind, ending in INCIDENT_NAMES.items()},
    MISTAKE: MISTAKE,
    "killed": "crash",
}
"""The end of an incident's id for an event's kind, or a note's `what`."""
STOOD_NS: Final = 100_000_000
"""A loop that is later than this at a stop is the reason for the stop."""
CAME_NS: Final = 500_000_000
"""Messages that were published while nobody read have arrived by then."""


FrameIn = tuple[RecordedMessage, Frame]
"""A frame, and its message in the recording."""


class Line(NamedTuple):
    """A time (ns since the incident), and a text."""

    at_ns: int
    text: str


def story(messages: list[RecordedMessage]) -> list[str]:
    """Return the lines to print for an incident's messages."""
    zero = _zero(messages)
    name = str(zero.content.get("detail"))
    reported = [each._replace(time_ns=each.time_ns - zero.time_ns) for each in messages if each is not zero]
    frames = list(frames_in(reported))
    notes = [each for each in reported if each.topic == RECORDER]
    lines = [*_commands(reported, frames, name), *_rejections(reported)]
    lines += _happened((each for each in reported if each.topic != RECORDER), name)
    lines += [*_stops(frames), *_happened(notes, name), *_landings(reported, frames), *_measured(reported)]
    lines.sort(key=lambda line: line.at_ns)
    width = max((len(relative_time(line.at_ns)) for line in lines), default=0)
    head = f"{name}: {headline(messages)}, at {zero.content.get('time')}"
    timed = (f"{relative_time(line.at_ns):>{width}}  {line.text}" for line in lines)
    return [visible(line) for line in (head, *_summary(reported), *timed)]


def headline(messages: Iterable[RecordedMessage]) -> str:
    """The worst that happened in an incident, who asked for it, which legs it stopped, and what else happened.

    Of many messages it holds few.
    """
    reported: list[RecordedMessage] = []
    moved_ns = array("q")  # when commands that move came
    for message in messages:
        kind = str(message.content.get("kind") or message.content.get("what"))
        if _is_watchdogs(message) or kind in _ENDINGS or kind in (INCIDENT, "lag"):
            reported.append(message)
        elif _is_command(message) and _moves(message):
            moved_ns.append(message.time_ns)
    zero = _zero(reported)
    happened = {kind_of(str(zero.content.get("detail"))): ""}
    for message in reported:
        ending = _ENDINGS.get(str(message.content.get("kind") or message.content.get("what")))
        if ending is not None and message.time_ns >= zero.time_ns:
            by = message.content.get("source")
            happened[ending] = happened.get(ending) or (f" ({by})" if by else "")
    if "landing" in happened:
        happened.pop("watchdog", None)  # its Stops are the landing's end
    worst = max(happened, key=lambda ending: _RANKS.get(ending, -1))
    legs = sorted(_stopped_legs(frames_in(reported), zero.time_ns))
    words = {ending: f"{WORDS.get(ending, ending)}{by}" for ending, by in happened.items()}
    if legs and "watchdog" in words:
        words["watchdog"] += f": {legs_named(legs)}"
    first = words.pop(worst)
    if worst in ("watchdog", "landing"):
        first = _stood_still(reported, moved_ns, zero.time_ns) or first
    return visible("; also: ".join((first, *words.values())))


def _zero(messages: Iterable[RecordedMessage]) -> RecordedMessage:
    """The note about the incident itself."""
    return next(each for each in messages if each.topic == RECORDER and each.content.get("what") == INCIDENT)


def _stood_still(notes: Sequence[RecordedMessage], moved_ns: Sequence[int], zero_ns: int) -> str:
    """Return a sentence if a leg was silent because the gateway stood still; empty if the gateway ran."""
    for note in notes:
        if note.content.get("what") != "lag":
            continue
        lag_ns = round(float(str(note.content["detail"]).removesuffix(" ms")) * 1e6)
        begun_ns = note.time_ns - lag_ns
        if lag_ns >= STOOD_NS and begun_ns - STOOD_NS <= zero_ns <= note.time_ns + STOOD_NS:
            came = any(begun_ns <= each <= note.time_ns + CAME_NS for each in moved_ns)
            return f"the gateway stood still for {lag_ns / 1e9:.1f} s{'; commands kept coming' if came else ''}"
    return ""


def relative_time(at_ns: int) -> str:
    """Return a time relative to the stop, such as +0.3 ms or -0.251 s."""
    sign = "−" if at_ns < 0 else "+" if at_ns else ""
    at_ms = abs(at_ns) / 1e6
    if 0 < at_ms < FINE_MS:
        return f"{sign}{at_ms:.1f} ms"
    return f"{sign}{at_ms / 1000:.3f} s"


# ---- who commanded


def _is_command(message: RecordedMessage) -> bool:
    return message.topic in keys.COMMAND_KEYS and "targets" in message.content


def _legs_of(message: RecordedMessage) -> list[int]:
    return sorted({target["id"] // 10 for target in message.content["targets"]})


def _moves(message: RecordedMessage) -> bool:
    return any(target["op"] != "stop" for target in message.content["targets"])


def _taken(message: RecordedMessage) -> bool:
    return message.content.get("verdict") in (None, "accepted", "coalesced")


def _who(source: Any) -> str:
    return str(source) if source else "somebody without a name"


def _asked(message: RecordedMessage, leg: int) -> str:
    """anna, set 90 45 120"""
    parts: list[str] = []
    for target in message.content["targets"]:
        if target["id"] // 10 == leg:
            angle = target.get("angle_deg")
            parts += [target["op"]] if not parts or parts[0] != target["op"] else []
            parts += [] if angle is None else [f"{angle:g}"]
    age = "" if message.content.get("verdict") else ", not decided"
    return f"{_who(message.content.get('source'))}, {' '.join(parts)}{age}"


def _summary(messages: list[RecordedMessage]) -> Iterator[str]:
    """One line for each source that commanded before the incident."""
    counts: Counter[str] = Counter()
    legs: dict[str, set[int]] = {}
    for message in messages:
        if _is_command(message) and message.time_ns <= 0 and message.content["targets"]:
            who = _who(message.content.get("source"))
            counts[who] += 1
            legs.setdefault(who, set()).update(_legs_of(message))
    for who, count in counts.most_common():
        commands = f"{count} command{'s' if count > 1 else ''}"
        yield f"Before it, {who} sent {commands} for {legs_named(sorted(legs[who]))}."


def _commands(messages: list[RecordedMessage], frames: Sequence[FrameIn], name: str) -> Iterator[Line]:
    """Yield the last command of each leg before the incident, and the first that moves one that it stopped."""
    concerned = _stopped_legs(frames) if kind_of(name) == "watchdog" else set(LEGS)
    stops = ((frame.leg, message.time_ns) for message, frame in frames if message.time_ns >= 0 and frame.is_stop)
    stopped_ns = dict(reversed(list(stops)))  # of each leg, its first Stop since the incident
    last: dict[int, RecordedMessage] = {}
    first: dict[int, RecordedMessage] = {}
    for message in messages:
        if _is_command(message) and _taken(message):
            if message.time_ns <= 0:
                last |= dict.fromkeys(_legs_of(message), message)
            elif _moves(message):
                again = (leg for leg in _legs_of(message) if stopped_ns.get(leg, message.time_ns) < message.time_ns)
                first = dict.fromkeys(again, message) | first
    for words, found in (("last command of", last), ("first command after it for", first)):
        for leg, message in found.items():
            if leg in concerned or words.startswith("first"):
                yield Line(message.time_ns, f"{words} leg {leg} ({_asked(message, leg)})")


def _stopped_legs(frames: Iterable[FrameIn], zero_ns: int = 0) -> set[int]:
    return {frame.leg for message, frame in frames if _is_watchdogs(message) and message.time_ns >= zero_ns}


def _is_watchdogs(frame: RecordedMessage) -> bool:
    return frame.content.get("cause") == Cause.WATCHDOG


def _rejections(messages: list[RecordedMessage]) -> Iterator[Line]:
    """Yield a line for the rejections of each source for one reason, on the same side of the incident."""
    runs: dict[tuple[str, str, bool], list[int]] = {}
    for message in messages:
        content, reason = message.content, None
        if _is_command(message) and not _taken(message):
            reason = content["verdict"]
        elif content.get("what") == "rejected":
            reason = content.get("detail")
        if reason is not None:
            case = _who(content.get("source")), str(reason), message.time_ns > 0
            runs.setdefault(case, []).append(message.time_ns)
    for (who, reason, _), times_ns in runs.items():
        text = f"a command of {who} is rejected: {reason}"
        if len(times_ns) > 1:
            text = f"{len(times_ns)} commands of {who} are rejected until {relative_time(times_ns[-1])}: {reason}"
        yield Line(times_ns[0], text)


# ---- what the gateway did


_REQUESTS: Final = {keys.ESTOP: "emergency stop", keys.RESET: "reset"}
_NOTES: Final = {
    "start": "a gateway starts ({detail})",
    "end": "the gateway ends: {detail}",
    "mode": "mode {detail}",
    "killed": "the gateway's last record; its process ended without a word",
    "stop-servos": "stop-servos has written a Stop to each of the six legs, {detail}",
    "left_out": "{detail} of {sender} were left out, more than the black box has room for",
    "lag": "the loop was {detail} late",
}
"""By a note's `what`."""


def _happened(messages: Iterable[RecordedMessage], name: str) -> Iterator[Line]:
    """Yield the requests of emergency stops and resets, the events, and what happened to the gateway itself."""
    for message in messages:
        content, at_ns = message.content, message.time_ns
        kind, source, detail = content.get("kind"), content.get("source"), str(content.get("detail"))
        if _is_command(message) and (request := _REQUESTS.get(message.topic)) is not None:
            verdict = "" if _taken(message) else f", rejected: {content['verdict']}"
            yield Line(at_ns, f"{request} requested by {_who(source)}{verdict}")
        elif message.topic == keys.EVENT and kind != Kind.COMMAND_REJECTED and (source or kind != Kind.LEGS_STOPPED):
            if kind == _AT_ZERO.get(kind_of(name)) and 0 <= at_ns < _TOGETHER_NS:
                at_ns = 0
            prefix = _EVENTS.get(kind, str(kind).replace("_", " "))
            sentence = detail if detail.startswith(prefix) else f"{prefix}: {detail}"
            yield Line(at_ns, f"{sentence} ({source})" if source else sentence)
        elif message.topic == RECORDER and (words := _NOTES.get(str(content.get("what")))) is not None:
            yield Line(at_ns, words.format(detail=detail, sender=source or "senders without a name"))


def _stops(frames: Iterable[FrameIn]) -> Iterator[Line]:
    """Stops; consecutive ones of one cause are one line. Frames that move are in the commands of the summary."""
    groups: list[list[FrameIn]] = []
    cause, last_ns = None, 0
    for message, frame in frames:
        if frame.is_stop:
            if message.content.get("cause") != cause or message.time_ns - last_ns > _TOGETHER_NS or not groups:
                groups.append([])
            groups[-1].append((message, frame))
            cause, last_ns = message.content.get("cause"), message.time_ns
    return map(_stops_in_one_line, groups)


def _stops_in_one_line(group: Sequence[FrameIn]) -> Line:
    first, last = group[0][0], group[-1][0]
    legs = sorted({frame.leg for _, frame in group})
    cause = str(first.content.get("cause"))
    written = "Stop repeated for" if cause == Cause.REPEAT else "Stop written to"
    until = "" if len(group) == 1 else f", the last at {relative_time(last.time_ns)}"
    late = first.content.get("late_us")
    after = "" if late is None else f", {late:.0f} µs after the deadline"
    why = "" if cause == Cause.REPEAT else f" ({cause})"
    return Line(first.time_ns, f"{written} {legs_named(legs)}{why}{after}{until}")


def _landings(messages: Iterable[RecordedMessage], frames: Iterable[FrameIn]) -> Iterator[Line]:
    """Yield the first and last frame of each way down, and where it left the legs: nobody commanded these frames."""
    begun = [each.time_ns for each in messages if each.topic == keys.EVENT and each.content.get("kind") == Kind.LANDING]
    stands: dict[int, int | None] = {}  # of each servo that ever had a frame: its angle, None: stopped
    ways: dict[int, list[tuple[int, str]]] = {}  # of each landing: when its frames were written, and where legs were
    for message, frame in frames:
        stands |= {servo_id: None if op.op is Op.STOP else op.angle_cdeg for servo_id, op in frame.servos}
        if _is_watchdogs(message) and not frame.is_stop:
            ways.setdefault(bisect(begun, message.time_ns), []).append((message.time_ns, _standing(stands)))
    for way in ways.values():
        (first_ns, _), (last_ns, standing) = way[0], way[-1]
        count = f"{len(way)} frames" if len(way) > 1 else "one frame"
        yield Line(first_ns, "first frame of the way down")
        yield Line(last_ns, f"last frame of the way down, after {count}; {standing}")


def _measured(messages: Iterable[RecordedMessage]) -> Iterator[Line]:
    """Measurements at the incident, at the largest tilt and at the lowest battery."""
    found = [
        (each.time_ns, Telemetry.model_validate(each.content)) for each in messages if each.topic == keys.TELEMETRY
    ]
    if not found:
        return
    named = {max((number for number, (at_ns, _) in enumerate(found) if at_ns <= 0), default=0): "measured"}
    tilts = {number: each.tilt_deg for number, (_, each) in enumerate(found) if each.tilt_deg is not None}
    volts = {number: each.battery.voltage_v for number, (_, each) in enumerate(found) if each.battery is not None}
    if tilts:
        named.setdefault(max(tilts, key=tilts.__getitem__), "tilted most")
    if volts:
        named.setdefault(min(volts, key=volts.__getitem__), "battery lowest")
    yield from (Line(found[number][0], f"{what}: {_values(found[number][1])}") for number, what in named.items())


def _values(measured: Telemetry) -> str:
    """tilt 2.1°, battery 7.40 V (80 %), 31.5 °C, feet 1 2 3 4 5 6"""
    parts = ["tilt unknown" if measured.tilt_deg is None else f"tilt {measured.tilt_deg:.1f}°"]
    if measured.battery is not None:
        parts.append(f"battery {measured.battery.voltage_v:.2f} V ({measured.battery.percent:.0f} %)")
    if measured.temperature_c is not None:
        parts.append(f"{measured.temperature_c:.1f} °C")
    if measured.feet is not None:
        parts.append("feet " + " ".join(f"{force:.3g}" for force in measured.feet))
    return ", ".join(parts)


def _standing(stands: dict[int, int | None]) -> str:
    """leg 3 at 90 45 120; legs 4, 5 at 90 off off"""
    legs: dict[str, list[int]] = {}
    for leg in LEGS:
        angles = [stands.get(10 * leg + joint) for joint in (1, 2, 3)]
        if angles != [None] * 3:
            words = " ".join("off" if angle is None else f"{angle / 100:g}" for angle in angles)
            legs.setdefault(words, []).append(leg)
    return "; ".join(f"{legs_named(numbers)} at {words}" for words, numbers in legs.items())


def frames_in(messages: Iterable[RecordedMessage]) -> Iterator[FrameIn]:
    """Return their frames in users' angles, if these are known."""
    angles = UserAngles()
    for message in messages:
        angles.take(message.topic, message.content)
        frame = angles.frame(message.content) if message.topic == keys.FRAME else None
        if frame is not None:
            yield message, frame
