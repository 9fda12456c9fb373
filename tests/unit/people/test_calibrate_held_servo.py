"""The servo that `calibrate` holds: each step confirmed before the next, and a Stop that waits for nothing."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from gateway.errors import LeaseLostError, UnansweredError
from gateway.people.tools.calibrate import holding as module
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
    assert held.holding.confirmed
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
        assert held.holding.unconfirmed is None


def test_a_stop_waits_for_no_answer() -> None:
    servos = Servos()
    with holding(servos) as held:
        servos.answers["set"].clear()
        servos.asked.clear()
        servos.wait(lambda asked: SETS in asked)
        held.stop()
        servos.wait(lambda asked: STOP in asked)


def test_a_start_that_a_stop_has_overtaken_is_stopped_again() -> None:
    servos = Servos()
    held = HeldServo(servos, timeout_ms=20)
    servos.answers["start"].clear()
    held.start(32, 90.0)
    servos.wait(lambda asked: (32, "start", 90.0) in asked)
    held.stop()
    servos.wait(lambda asked: STOP in asked)
    assert not held.close(0.05)  # the start may still come
    servos.answers["start"].set()
    assert held.close(LATE_S)
    assert servos.asked[-1] == STOP
    assert servos.running == set()


def test_space_stops_all_legs_whatever_runs() -> None:
    servos = Servos()
    held = HeldServo(servos)
    held.stop(all_legs=True)
    servos.wait(lambda asked: (None, "stop", None) in asked)
    wait_until(held, lambda: not held.stopping)
    held.stop()
    assert held.close(0)
    assert servos.asked == [(None, "stop", None)]


def test_a_stop_that_nobody_answers_is_asked_again_by_itself_and_said() -> None:
    servos = Servos()
    with holding(servos) as held:
        servos.fails = {op: UnansweredError("no gateway answered") for op in ("set", "stop")}
        wait_until(held, lambda: held.holding.unconfirmed is not None)
        assert (held.holding.fault, held.holding.unconfirmed) == ("no gateway answered", "no gateway answered")
        servos.wait(lambda asked: asked.count(STOP) > 1)
        servos.fails = {}
        wait_until(held, lambda: not held.stopping)
        assert held.holding.unconfirmed is None
        assert servos.running == set()


def test_who_took_the_lease_may_drive_the_leg() -> None:
    servos = Servos()
    with holding(servos) as held:
        servos.fails["set"] = LeaseLostError(Reason.NOT_HOLDER, "it is lost", "anna")
        wait_until(held, lambda: not held.holding.running and not held.stopping)
        assert STOP not in servos.asked


def test_a_stuck_screen_stops_it(monkeypatch: pytest.MonkeyPatch) -> None:
    servos = Servos()
    with holding(servos) as held:
        monkeypatch.setattr(module, "UNSEEN_S", 0.0)
        servos.wait(lambda asked: STOP in asked)
        assert held.holding.fault == "this terminal was stuck, so the servo was stopped"
