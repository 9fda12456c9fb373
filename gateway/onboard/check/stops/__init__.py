"""`check --stops`: prove on this robot, step by step, that it stops. Ends with everything stopped."""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Final

from gateway.errors import ConfigError, GatewayError
from gateway.model.telemetry import starts_whole
from gateway.onboard.check.stops.bench import Bench, FailedError, Figures, Skipped, StopsOptions
from gateway.onboard.check.stops.steps import STEPS, CheckStep
from gateway.people.commands.moving import ServoMotion, consents, lying, ready, stopped_after
from gateway.people.commands.reach import Connection, drives, show_differences
from gateway.people.terminal import NOBODY, hint, on_end_signals, rows, say
from schemas.telemetry import Mode

START_DEG: Final = 90.0
_IDLE_S: Final = 2.0
LEASE_S: Final = 1.0
"""Any time: a step holds the lease until it ends."""
_STYLES: Final = {"PASS": rows.GOOD, "FAIL": rows.BAD, "SKIPPED": rows.NOTE}


def stops(connect: Connection, options: StopsOptions) -> int:
    """Do the steps. Return the exit code.

    Raises ConfigError if nothing may be moved, ZenohError if no gateway answers, also where it is lost on the way.
    """
    unknown = set(options.only) - {step.name for step in STEPS}
    if unknown:
        raise ConfigError(f"no step {', '.join(sorted(unknown))}; there are {', '.join(step.name for step in STEPS)}")
    steps = [step for step in STEPS if not options.only or step.name in options.only]
    outcomes: list[dict[str, object]] = []
    with connect() as client:
        state = ready(client)
        show_differences(options.config)
        motion = ServoMotion(10 * options.leg + 1, START_DEG, lying(client, state) if starts_whole(state) else {})
        bench = Bench(client, motion, options)
        if not (state.simulated or options.agreed or sys.stdin.isatty()):
            raise ConfigError(NOBODY)
        if not (state.simulated or consents(motion, state, agreed=options.agreed)):
            raise ConfigError("nothing was moved")
        with bench.receives():
            bench.measure()  # no motion yet: without the right to command it ends here
            if not bench.frames_published:
                hint("The gateway publishes no frames (telemetry.frames), so what is measured comes from its state.")
            end = "land the robot, then stop it" if state.watchdog.landing_ms else "stop it"
            texts = {"servos": motion.which, "start": motion.start_deg, "end": motion.end_deg, "end_of_silence": end}
            with _ended_stopped(bench):
                for number, step in enumerate(steps, 1):
                    hint(f"{number}/{len(steps)} {step.name}: {step.does.format_map(texts)} …")
                    outcomes.append(_do(bench, step))
    failed = [str(outcome["step"]) for outcome in outcomes if outcome["result"] == "FAIL"]
    passed = len(outcomes) == len(steps) and not failed
    if options.as_json:
        say(json.dumps({"passed": passed, "steps": outcomes}))
        return 0 if passed else 1
    return rows.conclude("all passed" if passed else f"NOT passed: {', '.join(failed) or 'not finished'}", well=passed)


def _do(bench: Bench, step: CheckStep) -> dict[str, object]:
    """The step's outcome, as `--json` prints it."""
    result, figures = "PASS", Figures()
    try:
        with drives(bench.client, LEASE_S, moves=True):
            figures = step.run(bench)
        shown = {name: f"{value:.1f}" if isinstance(value, float) else value for name, value in figures.items()}
        detail = ", ".join(f"{name} {value}" for name, value in shown.items())
    except (FailedError, Skipped) as ended:
        result, detail = "FAIL" if isinstance(ended, FailedError) else "SKIPPED", str(ended)
    except GatewayError as error:
        result, detail = "FAIL", f"the check could not go on: {error}"
    if not bench.options.as_json:
        rows.show(rows.row(result, _STYLES[result], step.name, detail))
    with suppress(GatewayError, FailedError):  # the end tries again, and reports it
        _rest(bench)
    return {"step": step.name, "result": result, "detail": detail, "figures": figures}


def _rest(bench: Bench) -> None:
    """Stop all legs, and leave the emergency stop that this program has engaged."""
    bench.client.stop()
    if bench.estop and bench.client.state().mode == Mode.ESTOPPED:
        with suppress(FailedError):  # rejected where somebody else has engaged a newer one
            bench.reset()
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
            hint("The check was ended.")
        finally:
            stopping = True


def _all_stopped(bench: Bench) -> str:
    """Stop all legs. Returns the sentence that reports it."""
    _rest(bench)
    if running := bench.running():
        return f"Servos still run: {', '.join(map(str, running))}: switch their power off."
    return "All legs are stopped."
