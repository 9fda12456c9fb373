"""`check --wire`: test for its author whether a plug-in (`gateway.wire`) meets docs/protocol.md.

The plug-in is called as the gateway would call it, without a gateway, on the electronics that its options name.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, NamedTuple

from gateway.errors import ConfigError
from gateway.host import effective
from gateway.host.settings_table import WireSettings
from gateway.onboard.check.table import conclude, show
from gateway.people.terminal import ask
from gateway.robot import settings as settings_file
from gateway.robot.spi.bus import STALLED_NS
from gateway.wire import ServoWire
from schemas.robot import LEGS, SERVO_IDS

_MIDDLE_DEG: Final = 90.0
_BY_DEG: Final = 5.0
_ROUNDS: Final = 20
_HOLD_S: Final = 0.5
"""The pause between two motions, so that a person can see them."""
_LATE_MS: Final = 20.0
"""The shortest watchdog that can be set."""
_UNPLUGGED_S: Final = 60.0
_STOPS: Final = tuple((servo_id, None) for servo_id in SERVO_IDS)

Changes = Sequence[tuple[int, float | None]]


class BrokenError(Exception):
    """The plug-in breaks a rule; the message names it."""


class WireStep(NamedTuple):
    """One step. `run` returns a sentence. BrokenError, and any other exception, is a failure."""

    name: str
    run: Callable[["Tried"], str]


class Tried:
    """A plug-in under test, and the longest duration of its calls."""

    def __init__(self, wire: WireSettings) -> None:
        """Raises ConfigError if the plug-in rejects its options."""
        self._settings = wire
        self.wire = self.another()
        self.longest_ms: dict[bool, float] = {}
        """The longest `apply` with Stops (True) and with motions (False)."""

    def another(self) -> ServoWire:
        """Make another instance, as `stop-servos` does. Raises ConfigError."""
        try:
            return WireSettings(self._settings.name, self._settings.options).plugin
        except ValueError as error:
            raise ConfigError(f"wire: {error}") from error

    def apply(self, changes: Changes, wire: ServoWire | None = None) -> float:
        """Call `apply` and return its duration (ms). Raises BrokenError if it returns a value or stalls."""
        begun_ns = time.monotonic_ns()
        returned: object = (wire or self.wire).apply(changes)
        ms = (time.monotonic_ns() - begun_ns) / 1e6
        stops = changes[0][1] is None
        self.longest_ms[stops] = max(ms, self.longest_ms.get(stops, 0.0))
        if returned is not None:
            raise BrokenError(f"apply returned {returned!r}: nobody reads it; report a failure as an OSError")
        if ms * 1e6 >= STALLED_NS:
            raise BrokenError(f"apply took {ms / 1e3:.1f} s: the gateway counts that as a failure")
        return ms

    def groups(self) -> Iterator[tuple[int, ...]]:
        """Yield the groups of servos that start together: each leg, or the whole robot."""
        whole = self.wire.capabilities.whole_robot
        yield from [SERVO_IDS] if whole else [tuple(10 * leg + joint for joint in (1, 2, 3)) for leg in LEGS]


def conformance(config: Path | None, *, agreed: bool, unplug: bool) -> int:
    """Do the steps, and print each. Return the exit code. Raises ConfigError if nothing may be moved."""
    wire = settings_file.load(config).wire
    if wire.built_in is not None:
        raise ConfigError(f"--wire is for plug-ins, and {wire.name} is built in: --move and --stops try it")
    used = effective.read()
    if used is not None and used.runs:
        raise ConfigError("a gateway runs, and has the wire: end it first (sudo systemctl stop hexapod-gateway)")
    tried = Tried(wire)
    question = f"All servos go to {_MIDDLE_DEG:g}° and move by {_BY_DEG:g}°. Are all legs free? yes or no: "
    if not agreed and ask(question) != "yes":
        raise ConfigError("nothing was moved; --yes agrees")
    broken = 0
    with _ended_stopped(tried):
        for step in STEPS:
            if step.name == "unplugged" and not unplug:
                show("SKIPPED", step.name, "add --unplug to prove that an absent board is reported")
                continue
            try:
                show("PASS", step.name, step.run(tried))
            except Exception as error:  # of somebody else's code
                broken += 1
                said = str(error) if isinstance(error, BrokenError) else f"{type(error).__name__}: {error}"
                show("FAIL", step.name, said)
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
    return "an angle of 90.01° is accepted"


def _some(tried: Tried) -> str:
    if tried.wire.capabilities.whole_robot:
        return "not tested: its capabilities state that it stops only all servos together"
    tried.apply([(32, None)])
    tried.apply([(31, 90.0), (33, 90.0)])
    tried.apply([(32, 90.0)])
    return "servo 32 was stopped, and started again while others ran"


def _again(tried: Tried) -> str:
    tried.apply(_STOPS)
    tried.apply(_STOPS)
    return "Stops of stopped servos are accepted"


def _another(tried: Tried) -> str:
    second = tried.another()
    second.open()
    try:
        tried.apply(_STOPS, second)
    finally:
        second.close()
    tried.apply(_STOPS)
    return "a second instance stops the servos while the first is open, as stop-servos does"


def _reopen(tried: Tried) -> str:
    tried.wire.close()
    tried.wire.close()  # also where it is not open
    tried.wire.open()
    tried.apply(_STOPS)
    return "closed twice and opened again, it accepts Stops"


def _times(tried: Tried) -> str:
    for _ in range(_ROUNDS):
        for servos in tried.groups():
            tried.apply([(servo_id, _MIDDLE_DEG) for servo_id in servos])
        tried.apply(_STOPS)
    stops_ms, sets_ms = tried.longest_ms[True], tried.longest_ms[False]
    if stops_ms > _LATE_MS:
        raise BrokenError(f"Stops took up to {stops_ms:.1f} ms, longer than the shortest watchdog ({_LATE_MS:g} ms)")
    return f"Stops took up to {stops_ms:.1f} ms, motions up to {sets_ms:.1f} ms"


def _unplugged(tried: Tried) -> str:
    ask("Unplug the board, or switch its power off, then press Enter: ")
    end_s = time.monotonic() + _UNPLUGGED_S
    while True:
        try:
            tried.apply(_STOPS)
        except OSError as error:
            ask(f"The plug-in reports: {error}. Plug the board in again, then press Enter: ")
            break
        if time.monotonic() > end_s:
            raise BrokenError("apply raises no OSError, so an absent board looks like a stopped one")
        time.sleep(0.1)
    tried.wire.close()
    tried.wire.open()
    tried.apply(_STOPS)
    return "apply raises an OSError, and accepts Stops after close and open"


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
"""The steps in their order: later steps need what earlier ones opened."""
