"""The steps for a robot with a power board: what it confirms, and what happens when one way to it is unplugged."""

import sys
from typing import Final

from gateway.onboard.check.stops.bench import (
    EVIDENCE_S,
    Bench,
    FailedError,
    Figures,
    Skipped,
    demand,
    demand_accepted,
    demand_rejected,
)
from gateway.people.client.blocking import Client
from gateway.people.terminal import ask, hint
from schemas.robot import LEGS
from schemas.telemetry import Ack, GatewayState, Kind, Mode, PowerReport, Reason

REST_S: Final = 3.0
"""The board's errors are deleted behind a reset, for 2 s at most."""
SILENT_MS: Final = 200.0
"""After so long without an answer it is reported."""
PLUGGED_S: Final = 60.0
"""How long a person may take to plug or unplug something."""


def confirmed_off(bench: Bench) -> Figures:
    """An emergency stop: the board confirms that no servo is fed, and a reset feeds none."""
    _board(bench)
    bench.start()
    with bench.streaming():
        figures = _estop(bench)
        demand_rejected(bench.ask("start", bench.motion.start_deg), Reason.ESTOPPED, "a start without supply")
        demand(not _fed(bench), f"while the emergency stop is engaged, the board feeds {_fed(bench)}")
    _give_back(bench)
    return figures


def spi_unplugged(bench: Bench) -> Figures:
    """The controller cannot be reached while a servo runs: the emergency stop takes its supply all the same."""
    _by_hand(bench)
    bench.start()
    with bench.streaming():
        _asked("Unplug the servo controller from the Pi (SPI), and press Enter. The servo goes on holding: ")
        figures = _estop(bench, own=False)
    loose = ask("Turn the servo's horn gently with a finger: is it loose? yes or no: ")
    # The controller has not received its Stop: fed again, the servo would run.
    _asked("Plug the controller in again, and press Enter: ")
    again = bench.client.estop()  # six Stops, which arrive now
    demand(again.stop_frames == len(LEGS), f"{again.stop_frames} Stops were written, not {len(LEGS)}")
    bench.estop = again.estop or 0
    demand(loose == "yes", "the board has confirmed that it feeds no servo, and one is not loose")
    _give_back(bench)
    return figures


def can_unplugged(bench: Bench) -> Figures:
    """The board cannot be reached while a servo runs: that is reported, and the robot stopped over SPI."""
    _by_hand(bench)
    bench.start()
    with bench.streaming():
        events = len(bench.events)
        hint("Unplug the power board's CAN now, and leave its supply on …")
        seen = bench.wait(lambda: any(each.kind == Kind.POWER_UNCONFIRMED for each in bench.events[events:]), PLUGGED_S)
        silent_ms = _power(bench.client.state()).age_ms or 0.0
        demand(seen, f"no event power_unconfirmed has come within {PLUGGED_S:g} s")
        stopped = bench.wait(lambda: not bench.running(), bench.client.state().watchdog.stops_after_ms / 1000 + 1)
        demand(stopped, "it still runs, and the board does not answer")
        ack = bench.ask("start", bench.motion.start_deg)
        demand_rejected(ack, Reason.NO_POWER, "a start while the board does not answer")
        bench.demand_no_motion(bench.mark(), "while the board does not answer")
        _asked("Plug it in again, and press Enter: ")
        back = bench.wait(lambda: _power(bench.client.state()).alive, EVIDENCE_S)
        demand(back, "the board does not answer; is it in standby?")
        bench.demand_no_motion(bench.mark(), "once the board answers again")
    late_ms = silent_ms - SILENT_MS
    demand(late_ms <= bench.late_ms + bench.answer_ms, f"it was reported {silent_ms:.0f} ms after the last answer")
    return {"silent_when_reported_ms": silent_ms}


def _power(state: GatewayState) -> PowerReport:
    if state.power is None:
        raise FailedError("the gateway has no power board any more")
    return state.power


def _board(bench: Bench) -> PowerReport:
    """Raises Skipped where no servo's supply can be taken."""
    power = bench.client.state().power
    if power is None:
        raise Skipped("this robot has no power board")
    demand(power.alive, "the power board does not answer")
    return power


def _by_hand(bench: Bench) -> None:
    """Raises Skipped where nobody has agreed to unplug anything."""
    if not bench.unplug:
        raise Skipped("only with --unplug, and a person at the robot")
    _board(bench)
    if bench.client.state().simulated:
        raise Skipped("a simulated controller has no plug")


def _asked(what: str) -> None:
    if not sys.stdin.isatty():
        raise Skipped("nobody is there to unplug anything")
    ask(what)


def _fed(bench: Bench) -> tuple[int, ...]:
    return _power(bench.client.state()).supplied


def _estop(bench: Bench, *, own: bool = True) -> Figures:
    """`own`: to be left at the step's end, whatever happens."""
    ack: Ack = bench.client.estop()
    bench.estop = (ack.estop or 0) if own else 0
    demand(
        ack.confirmed,
        "the board has not confirmed that the servos have no supply: SWITCH IT OFF BY HAND",
    )
    demand(not _fed(bench), f"the board has confirmed that it feeds nothing, and feeds {_fed(bench)}")
    return {"confirmed_after_ms": ack.confirmed_ms or 0.0}


def _give_back(bench: Bench) -> None:
    """Leave the emergency stop: nothing is fed then, and nothing runs."""
    mark = bench.mark()
    demand_accepted(bench.reset(bench.estop), "the reset")
    demand(bench.wait(lambda: is_at_rest(bench.client), REST_S), "servos are fed after the reset, and none was started")
    bench.demand_no_motion(mark, "after the reset")


def is_at_rest(client: Client) -> bool:
    """Whether nothing runs, and the board answers and feeds nothing."""
    state = client.state()
    power = _power(state)
    return state.mode is Mode.IDLE and power.alive and not power.supplied
