"""The drill as a stop button, where the robot wants one more than are alive; and the step in which it falls silent."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

from gateway.errors import ConfigError
from gateway.people.terminal import hint, this_command
from gateway.people.tools.drill.bench import (
    EVIDENCE_S,
    QUIET_S,
    STREAM_S,
    Bench,
    Figures,
    Skipped,
    Watching,
    WrittenFrame,
    caused,
    demand,
    demand_rejected,
)
from schemas.robot import LEGS
from schemas.telemetry import Cause, GatewayState, Kind, Reason


@contextmanager
def watching(bench: Bench, state: GatewayState) -> Iterator[None]:
    """The drill is a button meanwhile, where one is missing; where enough are alive, or none is required, it is none.

    Raises ConfigError where more than one is missing.
    """
    required, alive = state.buttons.required, state.buttons.alive
    if alive >= required:
        yield
        return
    if alive < required - 1:
        raise ConfigError(
            f"{alive} of the {required} stop buttons that are required are alive, and nothing would start. The drill "
            f"is one itself: keep {required - 1} alive meanwhile ({this_command()} button)"
        )
    bench.watches = watches = Watching(bench.client)
    hint("The drill is one of the stop buttons that are required, until it ends.")
    watches.check_ins.start()
    try:
        if not bench.wait(lambda: bench.client.state().buttons.alive >= required, EVIDENCE_S):
            raise ConfigError(
                f"the drill is the button {watches.name}, and does not count: a button of the same certificate is "
                "alive already, or the robot's settings list others (buttons.names)"
            )
        yield
    finally:
        watches.check_ins.end()


def falls_silent(bench: Bench) -> Figures:
    """The drill's button checks in no more while setpoints stream: six Stops in time, no start until it is back."""
    button, buttons = bench.watches, bench.client.state().buttons
    if not buttons.required:
        raise Skipped("buttons.required is 0: this robot runs with nobody's hand on a stop")
    if button is None:
        raise Skipped(
            f"{buttons.alive} stop buttons of other people are alive, and {buttons.required} required: none is missing "
            "without the drill's own. Leave with one of them, and do this step again (--only button)"
        )
    bench.start()
    with bench.streaming():
        time.sleep(STREAM_S)
        demand(bench.running(), "the leg does not run in a stream of setpoints")
        mark, events = bench.mark(), len(bench.events)
        with button.silent():
            figures = _stopped_in_time(bench, button, mark)
            ack = bench.ask("start", bench.motion.start_deg)
            demand_rejected(ack, Reason.NO_BUTTON, "a start while too few buttons are alive")
            bench.demand_no_motion(bench.mark(), "while the button is silent")
            mark = bench.mark()
        back = bench.wait(lambda: bench.client.state().buttons.alive >= buttons.required, EVIDENCE_S)
        demand(back, f"the button {button.name} checks in again, and does not count")
        bench.demand_no_motion(mark, "once the button was back")
    reported = [event.kind for event in bench.events[events:] if event.source == button.name]
    demand(Kind.BUTTON_SILENT in reported, f"no event states that the button {button.name} was silent")
    return figures


def _stopped_in_time(bench: Bench, button: Watching, mark: int) -> Figures:
    """From its latest check-in, by the time at which it was asked and that at which the frames came here."""
    landing_ms = bench.client.state().watchdog.landing_ms or 0.0
    timeout_ms = button.check_ins.timeout_ms + landing_ms
    figures: Figures = {"timeout_ms": button.check_ins.timeout_ms, **({"landing_ms": landing_ms} if landing_ms else {})}

    def stops() -> list[WrittenFrame]:
        """Of each leg the first."""
        found = [seen for seen in caused(bench.since(mark), Cause.WATCHDOG) if not seen.moves]
        return list({seen.leg: seen for seen in reversed(found)}.values())

    stopped = bench.wait(lambda: not bench.running(), timeout_ms / 1000 + 1)
    by_state_ms = button.check_ins.silent_ms
    demand(stopped, f"it still runs, {by_state_ms:.0f} ms after the latest check-in; that counts for {timeout_ms:g} ms")
    if not bench.frames_published:
        late_ms = by_state_ms - timeout_ms - bench.answer_ms
        demand(late_ms <= bench.late_ms + bench.answer_ms, f"it ran on for {late_ms:.0f} ms after the time was over")
        return {**figures, "stopped_after_ms_by_state": by_state_ms}
    bench.wait(lambda: len(stops()) == len(LEGS), EVIDENCE_S)
    legs = sorted(seen.leg for seen in stops())
    demand(legs == list(LEGS), f"Stops were written for the legs {legs or 'none'} only")
    sixth_ms = (max(seen.came_s for seen in stops()) - button.check_ins.confirmed_s) * 1000
    late_ms = sixth_ms - timeout_ms
    demand(late_ms <= bench.late_ms + bench.answer_ms, f"the sixth Stop came {late_ms:.1f} ms after the time was over")
    demand(late_ms >= -bench.late_ms, f"the sixth Stop came {-late_ms:.1f} ms before the time was over")
    time.sleep(QUIET_S)
    return {**figures, "check_in_to_sixth_stop_ms": sixth_ms}
