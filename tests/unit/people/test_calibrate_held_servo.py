"""The servo that `calibrate` holds: each step confirmed before the next, and a Stop that waits for nothing."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from gateway.errors import LeaseLostError, UnansweredError
from gateway.people.tools.calibrate import held_servo as module
from gateway.people.tools.calibrate.held_servo import HeldServo
from schemas.telemetry import Reason
from tests.support.calibrated_robot import LATE_S, Servos

SETS = (32, "set", 90.0)
STOP = (3, "stop", None)


@contextmanager
def holding(servos: Servos) -> Iterator[HeldServo]:
    """Servo 32 at 90 degrees, confirmed."""
    held = HeldServo(servos, timeout_ms=20)
    held.start(32, 90.0)
    servos.wait(lambda asked: SETS in asked)
    assert held.confirmed
    try:
        yield held
    finally:
        for event in servos.answers.values():
            event.set()
        held.close(LATE_S)


def wait_until(held: HeldServo, holds: Callable[[], bool]) -> None:
    """Its threads need a moment; `seen`, as the screen does."""
    pause = threading.Event()
    for _ in range(int(LATE_S / 0.01)):
        if holds():
            return
        held.seen()
        pause.wait(0.01)
    pytest.fail("it did not come")


def test_it_starts_once_and_then_sets() -> None:
    servos = Servos()
    with holding(servos) as held:
        servos.wait(lambda asked: asked.count(SETS) > 2)
        assert servos.asked[0] == (32, "start", 90.0)
        assert [asked[1] for asked in servos.asked].count("start") == 1
        held.stop()
        servos.wait(lambda asked: STOP in asked)
        wait_until(held, lambda: not held.stopping)
        assert servos.asked[-1] == STOP
        assert held.unconfirmed is None


def test_one_step_is_under_way_at_most() -> None:
    servos = Servos()
    with holding(servos) as held:
        servos.answers["set"].clear()
        assert held.go(91.0)
        assert not any(held.go(angle_deg) for angle_deg in (92.0, 93.0, 94.0))
        servos.answers["set"].set()
        servos.wait(lambda asked: (32, "set", 91.0) in asked)
        wait_until(held, lambda: held.go(92.0))
        servos.wait(lambda asked: (32, "set", 92.0) in asked)
        assert max(asked[2] for asked in servos.asked if isinstance(asked[2], float)) == 92.0


def test_a_step_beyond_the_gateways_limit_is_taken_back_and_the_servo_goes_on() -> None:
    servos = Servos()
    servos.highest_deg = 90.0
    with holding(servos) as held:
        assert held.go(91.0)
        servos.wait(lambda asked: asked[-1] == SETS and (32, "set", 91.0) in asked)
        assert held.rejected_step() == ("91 is outside", 90.0)
        assert held.rejected_step() is None
        assert held.running


@pytest.mark.parametrize("op", ["start", "set"])
def test_a_stop_waits_for_no_answer(op: str) -> None:
    servos = Servos()
    with holding(servos) as held:
        if op == "start":
            held.stop()
            wait_until(held, lambda: not held.stopping)
            servos.asked.clear()
            servos.answers["start"].clear()
            held.start(32, 45.0)
            servos.wait(lambda asked: (32, "start", 45.0) in asked)
        else:
            servos.answers["set"].clear()
            servos.asked.clear()
            servos.wait(lambda asked: SETS in asked)
        held.stop()
        servos.wait(lambda asked: STOP in asked)


@pytest.mark.parametrize(("highest_deg", "stops"), [(180.0, 2), (45.0, 1)], ids=["accepted", "rejected"])
def test_a_start_that_a_stop_has_overtaken_is_stopped_again_where_it_was_accepted(
    highest_deg: float, stops: int
) -> None:
    """Where it was rejected, somebody else may run that leg by then."""
    servos = Servos()
    servos.highest_deg = highest_deg
    held = HeldServo(servos, timeout_ms=20)
    servos.answers["start"].clear()
    held.start(32, 90.0)
    servos.wait(lambda asked: (32, "start", 90.0) in asked)
    held.stop()
    servos.wait(lambda asked: STOP in asked)
    assert not held.close(0.05)  # the start may still come
    servos.answers["start"].set()
    assert held.close(LATE_S)
    assert (servos.asked[-1], servos.asked.count(STOP)) == (STOP, stops)
    assert servos.running == set()


def test_space_stops_all_legs_whatever_runs() -> None:
    servos = Servos()
    held = HeldServo(servos)
    held.stop(all_legs=True)
    servos.wait(lambda asked: (None, "stop", None) in asked)
    held.stop()
    assert held.close(0)
    assert servos.asked == [(None, "stop", None)]


def test_a_key_that_is_held_down_asks_for_four_stops_at_most() -> None:
    servos = Servos()
    held = HeldServo(servos)
    servos.answers["stop"].clear()
    for _ in range(30):
        held.stop(all_legs=True)
    servos.answers["stop"].set()
    wait_until(held, lambda: not held.stopping)
    assert len(servos.asked) <= 4


def test_what_somebody_else_stopped_is_not_started_again() -> None:
    servos = Servos()
    with holding(servos) as held:
        servos.running.clear()
        wait_until(held, lambda: not held.running)
        assert held.fault == "servo_stopped: servo 32 does not run"
        assert [asked[1] for asked in servos.asked].count("start") == 1
        assert STOP not in servos.asked


def test_a_lost_link_is_a_stop_that_is_asked_for_and_said() -> None:
    servos = Servos()
    with holding(servos) as held:
        servos.fails = {op: UnansweredError("no gateway answered") for op in ("set", "stop")}
        wait_until(held, lambda: held.unconfirmed is not None)
        assert (held.fault, held.unconfirmed) == ("no gateway answered", "no gateway answered")
        assert not held.close(0.05)  # it owes somebody a Stop
        servos.fails = {}
        assert held.close(LATE_S)


@pytest.mark.parametrize(("holder", "stops"), [("anna", False), (None, True)])
def test_who_took_the_lease_has_stopped_the_leg_and_may_drive_it(holder: str | None, stops: bool) -> None:
    servos = Servos()
    with holding(servos) as held:
        servos.fails["set"] = LeaseLostError(Reason.NOT_HOLDER, "it is lost", holder)
        wait_until(held, lambda: not held.running and not held.stopping)
        assert (STOP in servos.asked) is stops


def test_a_stuck_screen_and_an_empty_chair_stop_it(monkeypatch: pytest.MonkeyPatch) -> None:
    servos = Servos()
    for limit, fault in (("UNSEEN_S", "this terminal was stuck"), ("UNTOUCHED_S", "no key was pressed for 0 minutes")):
        with holding(servos) as held, monkeypatch.context() as patch:
            patch.setattr(module, limit, 0.0)
            servos.wait(lambda asked: STOP in asked)
            assert held.fault is not None
            assert held.fault.startswith(fault)
            servos.asked.clear()
