"""The drill as a whole: asks, does the steps, and leaves everything stopped whatever happens."""

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

from gateway.errors import ConfigError, GatewayError
from gateway.model.telemetry import starts_whole
from gateway.people.terminal import NOBODY, hint, on_end_signals, rows
from gateway.people.tools.drill.bench import Bench, FailedError, Figures, Skipped, WrittenFrame
from gateway.people.tools.drill.steps import STEPS, DrillStep
from gateway.people.tools.drill.watching import watching
from gateway.people.tools.driving import drives
from gateway.people.tools.moving import consents, lying, of_leg, ready, stopped_after
from gateway.people.tools.reach import Connection, show_differences
from schemas.telemetry import GatewayState, Mode

DRILL_SOURCE: Final = "hexapod-gateway drill"
_IDLE_S: Final = 2.0
LEASE_S: Final = 1.0
"""Any time: a step holds the lease until it ends."""
_STYLES: Final = {True: rows.GOOD, False: rows.BAD, None: rows.NOTE}


@dataclass(slots=True)
class StepResult:
    """The result of one step. `passed` is None where it was skipped."""

    name: str
    does: str
    shows: str
    """The claim of the safety case."""
    passed: bool | None
    detail: str
    figures: Figures
    took_s: float
    frames: list[WrittenFrame] = field(default_factory=list)

    @property
    def word(self) -> str:
        """PASS, FAIL or SKIPPED, as printed."""
        return "SKIPPED" if self.passed is None else "PASS" if self.passed else "FAIL"


@dataclass(slots=True)
class Drill:
    """The whole drill, for the report."""

    state: GatewayState
    leg: int
    frames_published: bool = False
    outcomes: list[StepResult] = field(default_factory=list)
    complete: bool = False
    lost: GatewayError | None = None
    """Why nobody has confirmed at the end that all legs are stopped."""

    @property
    def passed(self) -> bool:
        """Whether every step was done that could be, none failed, and all legs are stopped."""
        return self.complete and self.lost is None and all(outcome.passed is not False for outcome in self.outcomes)


def drill(
    connect: Connection,
    *,
    leg: int,
    angle_deg: float,
    whole_leg: bool,
    agreed: bool,
    only: Sequence[str],
    late_ms: float,
    endpoint: str | None,
    zenoh_config: Path | None,
    restart: bool,
    unplug: bool,
    config: Path | None,
) -> Drill:
    """Do the steps. Raises ConfigError where nothing is to be moved, ZenohError where no gateway answers.

    Where the gateway is lost on the way, `Drill.lost` is set.
    """
    found: Drill | None = None
    steps = [step for step in STEPS if not only or step.name in only]
    try:
        with connect() as client:
            state = ready(client)
            show_differences(config)
            holding = lying(client, state) if starts_whole(state) else {}
            bench = Bench(
                client,
                of_leg(leg, angle_deg, whole=whole_leg, holding=holding),
                reaches={"endpoint": endpoint, "zenoh_config": zenoh_config},
                late_ms=late_ms,
                lands=bool(state.watchdog.landing_ms),
                restart=restart,
                unplug=unplug,
                config=() if config is None else ("--config", str(config)),
            )
            if not state.simulated:
                _agree(bench, state, agreed=agreed)
            with bench.receives(), watching(bench, state):
                bench.measure()  # no motion yet: without the right to command it ends here
                found = Drill(state, leg, bench.frames_published)
                if not bench.frames_published:
                    hint(
                        "The gateway publishes no frames (telemetry.frames), so what is measured comes from its state."
                    )
                with _ended_stopped(bench):
                    for number, step in enumerate(steps, 1):
                        found.outcomes.append(_do(bench, step, f"{number}/{len(steps)}"))
                    found.complete = True
    except GatewayError as error:
        if found is None:
            raise
        found.lost = error
    return found


def _do(bench: Bench, step: DrillStep, place: str) -> StepResult:
    end_of_silence = "land the robot, then stop it" if bench.lands else "stop it"
    does = step.does.format(
        servos=bench.motion.which, start=bench.motion.start_deg, end=bench.motion.end_deg, end_of_silence=end_of_silence
    )
    hint(f"{place} {step.name}: {does} …")
    mark, begun_s = bench.mark(), time.monotonic()
    passed: bool | None = True
    figures: Figures = {}
    try:
        with drives(bench.client, LEASE_S if step.drives else 0, moves=True) as bench.lease:
            figures = step.run(bench)
        detail = ", ".join(f"{name} {_short(value)}" for name, value in figures.items())
    except FailedError as failed:
        passed, detail = False, str(failed)
    except Skipped as skipped:
        passed, detail = None, str(skipped)
    except GatewayError as error:
        passed, detail = False, f"the drill could not go on: {error}"
    outcome = StepResult(
        step.name, does, step.shows, passed, detail, figures, time.monotonic() - begun_s, bench.since(mark)
    )
    rows.show(rows.row(outcome.word, _STYLES[passed], step.name, detail))
    with suppress(GatewayError):  # the end tries again, and reports it
        _rest(bench, keep_estop=step.name == "estop")
    return outcome


def _short(value: float | int | str) -> str:
    return f"{value:.1f}" if isinstance(value, float) else str(value)


def _rest(bench: Bench, *, keep_estop: bool = False) -> None:
    """All legs stopped; the drill's own emergency stop left, unless the next step goes on with it."""
    bench.client.stop()
    if not keep_estop and bench.estop and bench.client.state().mode == Mode.ESTOPPED:
        bench.reset(bench.estop)  # rejected where somebody else has engaged a newer one
    bench.wait(lambda: bench.client.state().mode in (Mode.IDLE, Mode.ESTOPPED), _IDLE_S)


@contextmanager
def _ended_stopped(bench: Bench) -> Iterator[None]:
    """However it ends, also by a signal, all legs are stopped, and a sentence reports it."""
    stopping = False

    def end() -> None:
        nonlocal stopping
        if not stopping:  # a second Ctrl-C must not cost the Stop that the first one asks for
            stopping = True
            raise KeyboardInterrupt

    with on_end_signals(end), stopped_after("all legs are", partial(_all_stopped, bench)):
        try:
            yield
        except KeyboardInterrupt:
            hint("The drill was ended.")
        finally:
            stopping = True


def _all_stopped(bench: Bench) -> str:
    """Stop all legs. Returns the sentence that reports it."""
    _rest(bench)
    if running := bench.running():
        return f"Servos still run: {', '.join(map(str, running))}: switch their power off."
    return "All legs are stopped."


def _agree(bench: Bench, state: GatewayState, *, agreed: bool) -> None:
    """Raises ConfigError where nobody agrees."""
    if not agreed and not sys.stdin.isatty():
        raise ConfigError(NOBODY)
    if not consents(bench.motion, state, agreed=agreed):
        raise ConfigError("nothing was moved")
