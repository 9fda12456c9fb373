"""`check --wire`: test for its author whether a plug-in (`gateway.wire`) meets docs/protocol.md.

The plug-in is called as the gateway would call it, without a gateway, on the electronics that its options name.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import closing, nullcontext, suppress
from pathlib import Path
from typing import Final

from gateway.errors import ConfigError
from gateway.host import effective
from gateway.host.settings_table import WireSettings
from gateway.onboard.check.table import CheckStep, FailedError, Skipped, conclude, demand, ms_since
from gateway.people.commands.moving import NOTHING_MOVED
from gateway.people.terminal import ask
from gateway.robot import settings as settings_file
from gateway.robot.spi.bus import STALLED_NS
from gateway.wire import ServoWire
from schemas.robot import JOINTS, LEGS, SERVO_IDS

_MIDDLE_DEG, _BY_DEG = 90.0, 5.0
_ROUNDS: Final = 20
_HOLD_S: Final = 0.5
"""The pause after a motion, so that a person can see it."""
_LATE_MS: Final = 20.0
"""The shortest watchdog that can be set."""
_UNPLUGGED_S: Final = 60.0
_STOPS: Final = tuple((servo_id, None) for servo_id in SERVO_IDS)

Changes = Sequence[tuple[int, float | None]]


class Tried:
    """A plug-in under test, and the longest duration of its calls."""

    def __init__(self, another: Callable[[], ServoWire], unplug: bool) -> None:
        self.another, self.unplug = another, unplug
        self.wire = another()
        self.longest_ms = {True: 0.0, False: 0.0}
        """The longest `apply` with Stops (True) and with motions (False)."""

    def apply(self, *calls: Changes, wire: ServoWire | None = None) -> None:
        """Call `apply` with each of these. Raises FailedError if it returns a value or stalls."""
        for changes in calls:
            begun_s, stops = time.monotonic(), changes[0][1] is None
            returned: object = (wire or self.wire).apply(changes)
            ms = ms_since(begun_s)
            self.longest_ms[stops] = max(ms, self.longest_ms[stops])
            demand(returned is None, f"apply returned {returned!r}: nobody reads it; report a failure as an OSError")
            demand(ms * 1e6 < STALLED_NS, f"apply took {ms / 1e3:.1f} s: the gateway counts that as a failure")

    def move(self, *angles_deg: float, hold_s: float = 0.0) -> None:
        """Move the servos that start together, each leg or the whole robot, one group after the other."""
        legs = [tuple(10 * leg + joint for joint in JOINTS) for leg in LEGS]
        for servos in [SERVO_IDS] if self.wire.capabilities.whole_robot else legs:
            for angle_deg in angles_deg:
                self.apply([(servo_id, angle_deg) for servo_id in servos])
                time.sleep(hold_s)


def conformance(config: Path | None, *, agreed: bool, unplug: bool) -> int:
    """Do the steps, and print each. Return the exit code. Raises ConfigError if nothing may be moved."""
    wire = settings_file.load(config).wire
    if wire.built_in is not None:
        raise ConfigError(f"--wire is for plug-ins, and {wire.name} is built in: --move and --stops try it")
    if effective.running() is not None:
        raise ConfigError("a gateway runs, and has the wire: end it first (sudo systemctl stop hexapod-gateway)")
    try:
        tried = Tried(lambda: WireSettings(wire.name, wire.options).plugin, unplug)
    except ValueError as error:
        raise ConfigError(f"wire: {error}") from error
    question = f"All servos go to {_MIDDLE_DEG:g}° and move by {_BY_DEG:g}°. Are all legs free? yes or no: "
    if not agreed and ask(question) != "yes":
        raise ConfigError(NOTHING_MOVED)
    try:
        opened = STEPS[0].outcome(tried, nullcontext())["result"] == "PASS"
        results = [step.outcome(tried, nullcontext())["result"] for step in STEPS[1:] if opened]
    finally:
        with suppress(Exception):
            tried.wire.apply(_STOPS)
        with suppress(Exception):
            tried.wire.close()
    if not opened:
        return conclude(f"{wire.name} does not open, so nothing else was tried", well=False)
    broken = results.count("FAIL")
    return conclude(f"NOT kept: {broken} of {len(STEPS)}" if broken else f"{wire.name} keeps it all", well=not broken)


# ---- the steps


def _some(tried: Tried) -> None:
    if tried.wire.capabilities.whole_robot:
        raise Skipped("its capabilities state that it stops only all servos together")
    tried.apply([(32, None)], [(31, 90.0), (33, 90.0)], [(32, 90.0)])


def _another(tried: Tried) -> None:
    second = tried.another()
    second.open()
    with closing(second):
        tried.apply(_STOPS, wire=second)
    tried.apply(_STOPS)


def _reopen(tried: Tried) -> None:
    tried.wire.close()
    tried.wire.close()  # also where it is not open
    tried.wire.open()
    tried.apply(_STOPS)


def _times(tried: Tried) -> str:
    for _ in range(_ROUNDS):
        tried.move(_MIDDLE_DEG)
        tried.apply(_STOPS)
    took = f"Stops took up to {tried.longest_ms[True]:.1f} ms"
    demand(tried.longest_ms[True] <= _LATE_MS, f"{took}, longer than the shortest watchdog ({_LATE_MS:g} ms)")
    return f"{took}, motions up to {tried.longest_ms[False]:.1f} ms"


def _unplugged(tried: Tried) -> None:
    if not tried.unplug:
        raise Skipped("add --unplug to prove that an absent board is reported")
    ask("Unplug the board, or switch its power off, then press Enter: ")
    end_s = time.monotonic() + _UNPLUGGED_S
    try:
        while time.monotonic() <= end_s:
            tried.apply(_STOPS)
            time.sleep(0.1)
        raise FailedError("apply raises no OSError, so an absent board looks like a stopped one")
    except OSError as error:
        ask(f"The plug-in reports: {error}. Plug the board in again, then press Enter: ")
    _reopen(tried)


# fmt: off
STEPS: Final = (
    CheckStep("open", "it opens", lambda tried: tried.wire.open()),
    CheckStep("stops", "18 Stops in one call are accepted", lambda tried: tried.apply(_STOPS)),
    CheckStep("start", f"all servos at {_MIDDLE_DEG:g}°", lambda tried: tried.move(_MIDDLE_DEG, hold_s=_HOLD_S)),
    CheckStep("set", f"by {_BY_DEG:g}° and back",
         lambda tried: tried.move(_MIDDLE_DEG + _BY_DEG, _MIDDLE_DEG, hold_s=_HOLD_S)),
    CheckStep("hundredths", "an angle of 90.01° is accepted",
         lambda tried: tried.apply([(servo_id, 90.01) for servo_id in SERVO_IDS])),
    CheckStep("single servos", "servo 32 was stopped, and started again while others ran", _some),
    CheckStep("stops again", "Stops of stopped servos are accepted", lambda tried: tried.apply(_STOPS, _STOPS)),
    CheckStep("stop-servos", "a second instance stops the servos while the first is open, as stop-servos does",
         _another),
    CheckStep("reopen", "closed twice and opened again, it accepts Stops", _reopen),
    CheckStep("times", "", _times),
    CheckStep("unplugged", "apply raises an OSError, and accepts Stops after close and open", _unplugged),
)
# fmt: on
"""The steps in their order: later steps need what earlier ones opened."""
