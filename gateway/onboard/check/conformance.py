"""`check --wire`: does a plug-in (`gateway.wire`) meet docs/protocol.md? For its author.

It is called as the gateway would call it, without a gateway: on real electronics, or whatever its options name.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, NamedTuple

from gateway.errors import ConfigError
from gateway.host import effective
from gateway.host.settings_table import WireSettings
from gateway.onboard.check.table import BAD, GOOD, NOTE, conclude, show
from gateway.people.terminal import ask
from gateway.robot import settings as settings_file
from gateway.robot.spi.bus import STALLED_NS
from gateway.wire import ServoWire
from schemas.robot import LEGS, SERVO_IDS

_MIDDLE_DEG: Final = 90.0
_BY_DEG: Final = 5.0
_ROUNDS: Final = 20
_HOLD_S: Final = 0.5
"""Between two motions, for a person who looks."""
_LATE_MS: Final = 20.0
"""The shortest watchdog that can be set."""
_UNPLUGGED_S: Final = 60.0
_STOPS: Final = tuple((servo_id, None) for servo_id in SERVO_IDS)

Changes = Sequence[tuple[int, float | None]]


class BrokenError(Exception):
    """What the plug-in does not keep, as a sentence."""


class WireStep(NamedTuple):
    """One row of the table. `run` returns a sentence, or raises BrokenError; an OSError counts as one."""

    name: str
    run: Callable[["Tried"], str]


class Tried:
    """A plug-in, and how long its calls took."""

    def __init__(self, wire: WireSettings) -> None:
        """Raises ConfigError."""
        self._settings = wire
        self.wire = self.another()
        self.longest_ms: dict[bool, float] = {}
        """Of `apply`: with Stops, and without."""

    def another(self) -> ServoWire:
        """A second one, as `stop-servos` makes it. Raises ConfigError."""
        try:
            return WireSettings(self._settings.name, self._settings.options).plugin
        except ValueError as error:
            raise ConfigError(f"wire: {error}") from error

    def apply(self, changes: Changes, wire: ServoWire | None = None) -> float:
        """Call it; the ms that it took."""
        begun_ns = time.monotonic_ns()
        returned: object = (wire or self.wire).apply(changes)
        ms = (time.monotonic_ns() - begun_ns) / 1e6
        stops = changes[0][1] is None
        self.longest_ms[stops] = max(ms, self.longest_ms.get(stops, 0.0))
        if returned is not None:
            raise BrokenError(f"apply returned {returned!r}: nobody reads it, so a failure has to be an OSError")
        if ms * 1e6 >= STALLED_NS:
            raise BrokenError(f"apply took {ms / 1e3:.1f} s: the gateway counts that as a failure")
        return ms

    def groups(self) -> Iterator[tuple[int, ...]]:
        """The servos that are started together."""
        whole = self.wire.capabilities.whole_robot
        yield from [SERVO_IDS] if whole else [tuple(10 * leg + joint for joint in (1, 2, 3)) for leg in LEGS]


def conformance(config: Path | None, *, agreed: bool, unplug: bool) -> int:
    """Do the steps, and print each. Return the exit code. Raises ConfigError where nothing may be moved."""
    wire = settings_file.load(config).wire
    if wire.built_in is not None:
        raise ConfigError(f"--wire is for plug-ins, and {wire.name} is built in: --move and --stops try it")
    used = effective.read()
    if used is not None and used.runs:
        raise ConfigError("a gateway runs, and has the wire: end it first (sudo systemctl stop hexapod-gateway)")
    tried = Tried(wire)
    question = f"All servos go to {_MIDDLE_DEG:g}°, and move by {_BY_DEG:g}°. Do they hang free? yes or no: "
    if not agreed and ask(question) != "yes":
        raise ConfigError("nothing was moved; --yes agrees")
    broken = 0
    with _ended_stopped(tried):
        for step in STEPS:
            if step.name == "unplugged" and not unplug:
                show("SKIPPED", NOTE, step.name, "--unplug asks for it: a dead board must not pass for a written Stop")
                continue
            try:
                show("PASS", GOOD, step.name, step.run(tried))
            except Exception as error:  # of somebody else's code
                broken += 1
                said = str(error) if isinstance(error, BrokenError) else f"{type(error).__name__}: {error}"
                show("FAIL", BAD, step.name, said)
    return conclude(f"NOT kept: {broken} of {len(STEPS)}" if broken else f"{wire.name} keeps it all", well=not broken)


@contextmanager
def _ended_stopped(tried: Tried) -> Iterator[None]:
    try:
        yield
    finally:
        with suppress(Exception):
            tried.wire.apply(_STOPS)
        with suppress(Exception):
            tried.wire.close()


# ---- the steps


def _open(tried: Tried) -> str:
    begun_ns = time.monotonic_ns()
    tried.wire.open()
    return f"open took {(time.monotonic_ns() - begun_ns) / 1e6:.1f} ms"


def _stops(tried: Tried) -> str:
    return f"18 Stops in one call took {tried.apply(_STOPS):.1f} ms"


def _start(tried: Tried) -> str:
    for servos in tried.groups():
        tried.apply([(servo_id, _MIDDLE_DEG) for servo_id in servos])
    time.sleep(_HOLD_S)
    return f"all servos at {_MIDDLE_DEG:g}°"


def _set(tried: Tried) -> str:
    for servos in tried.groups():
        for step_deg in (_BY_DEG, 0.0):
            tried.apply([(servo_id, _MIDDLE_DEG + step_deg) for servo_id in servos])
            time.sleep(_HOLD_S)
    return f"by {_BY_DEG:g}° and back"


def _hundredths(tried: Tried) -> str:
    tried.apply([(servo_id, 90.01) for servo_id in SERVO_IDS])
    return "an angle of 90.01° is taken"


def _some(tried: Tried) -> str:
    if tried.wire.capabilities.whole_robot:
        return "it stops all servos together only, by its capabilities"
    tried.apply([(32, None)])
    tried.apply([(31, 90.0), (33, 90.0)])
    tried.apply([(32, 90.0)])
    return "servo 32 stopped, and started again beside others"


def _again(tried: Tried) -> str:
    tried.apply(_STOPS)
    tried.apply(_STOPS)
    return "Stops of stopped servos are taken"


def _another(tried: Tried) -> str:
    second = tried.another()
    second.open()
    try:
        tried.apply(_STOPS, second)
    finally:
        second.close()
    tried.apply(_STOPS)
    return "as stop-servos does, while the first is open"


def _reopen(tried: Tried) -> str:
    tried.wire.close()
    tried.wire.close()  # also where it is not open
    tried.wire.open()
    tried.apply(_STOPS)
    return "closed twice, opened anew, Stops taken"


def _times(tried: Tried) -> str:
    for _ in range(_ROUNDS):
        for servos in tried.groups():
            tried.apply([(servo_id, _MIDDLE_DEG) for servo_id in servos])
        tried.apply(_STOPS)
    stops_ms, sets_ms = tried.longest_ms[True], tried.longest_ms[False]
    if stops_ms > _LATE_MS:
        raise BrokenError(f"Stops took up to {stops_ms:.1f} ms, longer than the shortest watchdog ({_LATE_MS:g} ms)")
    return f"Stops took up to {stops_ms:.1f} ms, what moves up to {sets_ms:.1f} ms"


def _unplugged(tried: Tried) -> str:
    ask("Take the plug (or the power of the board), then press Enter: ")
    end_s = time.monotonic() + _UNPLUGGED_S
    while True:
        try:
            tried.apply(_STOPS)
        except OSError as error:
            ask(f"The plug-in reports: {error}. Put it back, then press Enter: ")
            break
        if time.monotonic() > end_s:
            raise BrokenError("apply raises no OSError: a board that is gone passes for one that is stopped")
        time.sleep(0.1)
    tried.wire.close()
    tried.wire.open()
    tried.apply(_STOPS)
    return "an OSError, and Stops taken behind close and open"


STEPS: Final = (
    WireStep("open", _open),
    WireStep("stops", _stops),
    WireStep("start", _start),
    WireStep("set", _set),
    WireStep("hundredths", _hundredths),
    WireStep("single servos", _some),
    WireStep("stops again", _again),
    WireStep("stop-servos", _another),
    WireStep("reopen", _reopen),
    WireStep("times", _times),
    WireStep("unplugged", _unplugged),
)
"""In their order: a later one needs what an earlier one has opened."""
