"""The servo that `calibrate` holds, in virtual time: when it is asked for what, and when it is owed a Stop."""

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from gateway.people.tools.calibrate.holding import ALL_LEGS, UNSEEN_S, UNTOUCHED_S, Holding, Wanted
from schemas.telemetry import Ack, Reason

TAKEN = Ack(accepted=True)


def rejected(reason: Reason) -> Ack:
    return Ack(accepted=False, reason=reason, detail="why")


class Held(Holding):
    """Servo 32 at 90 degrees, confirmed at 0 s."""

    def __init__(self) -> None:
        super().__init__(0.0)
        self.start(32, 90.0, 0.0)
        self.answered(self.due(), TAKEN, 0.0)

    def due(self, now_s: float = 0.0) -> Wanted:
        wanted = self.look(now_s)
        assert wanted is not None
        return wanted


def test_it_starts_once_and_then_sets() -> None:
    holding = Holding(0.0)
    assert (holding.look(0.0), holding.has_run) == (None, False)
    holding.start(32, 90.0, 0.0)
    start = holding.look(0.0)
    assert start == Wanted(1, 32, "start", 90.0)
    assert not holding.confirmed
    assert not holding.answered(start, TAKEN, 0.1)
    assert (holding.confirmed, holding.has_run) == (True, True)
    assert holding.look(0.2) == Wanted(1, 32, "set", 90.0)
    assert not holding.takes_stop()


def test_one_step_is_under_way_at_most() -> None:
    holding = Held()
    assert holding.go(91.0)
    assert not holding.go(92.0)
    step = holding.due()
    assert (step.op, step.angle_deg) == ("set", 91.0)
    holding.answered(step, TAKEN, 0.1)
    assert holding.go(92.0)


def test_a_step_beyond_the_gateways_limit_is_taken_back_at_once() -> None:
    holding = Held()
    holding.go(91.0)
    assert holding.answered(holding.due(), rejected(Reason.JOINT_LIMIT), 0.1)
    assert holding.due().angle_deg == 90.0
    assert (holding.rejected_step(), holding.rejected_step()) == (("why", 90.0), None)


@pytest.mark.parametrize(
    ("limit_s", "does", "fault"),
    [
        (UNSEEN_S, Holding.touched, "this terminal was stuck, so the servo was stopped"),
        (UNTOUCHED_S, Holding.seen, "no key was pressed for 2 minutes, so the servo was stopped"),
    ],
)
def test_a_stuck_screen_and_an_empty_chair_stop_it(limit_s: float, does: object, fault: str) -> None:
    holding = Held()
    assert callable(does)
    does(holding, limit_s)
    assert holding.look(limit_s) is not None
    assert not holding.takes_stop()
    does(holding, limit_s + 0.001)
    assert holding.look(limit_s + 0.001) is None
    assert (holding.fault, holding.takes_stop(), holding.owed) == (fault, True, 3)
    assert not holding.takes_stop(), "each is taken once"
    assert holding.look(limit_s + 0.002) is None


def test_each_key_counts_anew() -> None:
    holding = Held()
    for now_s in (UNTOUCHED_S, 2 * UNTOUCHED_S):
        holding.touched(now_s)
        holding.seen(now_s)
        assert holding.look(now_s) is not None
    holding.start(32, 90.0, 5 * UNTOUCHED_S)
    assert holding.look(5 * UNTOUCHED_S) is not None, "who starts one is there"


def test_the_stop_is_for_its_own_leg() -> None:
    for overtaken in (False, True):
        holding = Holding(0.0)
        holding.start(63, 90.0, 0.0)
        assert (holding.running, holding.has_run) == (True, False)
        start = holding.look(0.0)
        assert start is not None
        if overtaken:
            holding.stop()
            holding.stop_ended(None, more=False)
            assert not holding.answered(start, TAKEN, 0.1)
        else:
            assert not holding.answered(start, TAKEN, 0.1)
            holding.stop()
        assert (holding.owed, holding.running) == (6, False)


def test_what_ends_it_is_asked_no_more() -> None:
    holding = Held()
    assert not holding.answered(holding.due(), rejected(Reason.NO_LEASE), 0.1)
    assert not holding.running


def test_for_how_long_nobody_has_answered() -> None:
    holding = Held()
    assert holding.unanswered_s(2.5) == 2.5
    holding.answered(holding.due(), TAKEN, 2.5)
    assert holding.unanswered_s(3.0) == 0.5
    holding.stop()
    assert holding.unanswered_s(9.0) == 0.0


@pytest.mark.parametrize(("all_legs", "owed"), [(False, 3), (True, ALL_LEGS)])
def test_a_stop_is_owed_until_it_is_confirmed(all_legs: bool, owed: int) -> None:
    holding = Held()
    holding.stop(all_legs=all_legs)
    holding.stop()
    assert (holding.takes_stop(), holding.owed, holding.look(0.1)) == (True, owed, None)
    holding.stop_ended("no answer", more=False)
    assert (holding.unconfirmed, holding.owed) == ("no answer", owed)
    holding.stop_ended(None, more=True)
    assert not holding.is_stopped, "it may be the answer to what was pressed before"
    holding.stop_ended(None, more=False)
    assert (holding.unconfirmed, holding.owed, holding.is_stopped) == (None, None, True)


def test_a_stop_of_all_legs_stays_one_where_a_start_comes_behind_it() -> None:
    holding = Holding(0.0)
    holding.start(32, 90.0, 0.0)
    start = holding.look(0.0)
    assert start is not None
    holding.stop(all_legs=True)
    holding.answered(start, TAKEN, 0.1)
    assert holding.owed == ALL_LEGS


def test_where_nothing_was_started_only_all_legs_are_stopped() -> None:
    holding = Holding(0.0)
    holding.stop()
    assert not holding.takes_stop()
    holding.stop(all_legs=True)
    assert (holding.takes_stop(), holding.owed) == (True, ALL_LEGS)


@pytest.mark.parametrize(("outcome", "stops"), [("accepted", True), ("rejected", False), ("failed", True)])
def test_a_start_that_a_stop_has_overtaken_is_stopped_again_where_it_may_run(outcome: str, stops: bool) -> None:
    """Where it was rejected, somebody else may run that leg by then."""
    holding = Holding(0.0)
    holding.start(32, 90.0, 0.0)
    start = holding.look(0.0)
    assert start is not None
    holding.stop()
    assert (holding.takes_stop(), holding.start_is_overtaken) == (True, True)
    holding.stop_ended(None, more=False)
    assert not holding.is_stopped
    if outcome == "failed":
        holding.failed(start, "no answer", theirs=False)
    else:
        holding.answered(start, TAKEN if outcome == "accepted" else rejected(Reason.NOT_HOLDER), 0.1)
    assert holding.takes_stop() is stops
    assert holding.owed == (3 if stops else None)
    assert holding.fault is None


def test_of_a_start_that_another_has_overtaken_nobody_knows_which_runs() -> None:
    holding = Holding(0.0)
    holding.start(32, 90.0, 0.0)
    start = holding.look(0.0)
    assert start is not None
    holding.start(41, 90.0, 0.0)
    assert holding.owed is None, "no Stop goes to what is wanted"
    holding.answered(start, TAKEN, 0.1)
    assert holding.takes_stop()
    assert holding.owed == ALL_LEGS


@pytest.mark.parametrize("reason", [Reason.SERVO_STOPPED, Reason.ESTOPPED, Reason.STALE])
def test_a_rejection_ends_it_and_stops_it_where_it_may_still_run(reason: Reason) -> None:
    holding = Held()
    holding.answered(holding.due(), rejected(reason), 0.1)
    assert (holding.wanted, holding.fault) == (None, f"{reason}: why")
    assert holding.takes_stop() is (reason is Reason.STALE)


def test_a_start_that_is_rejected_needs_no_stop() -> None:
    holding = Holding(0.0)
    holding.start(32, 90.0, 0.0)
    start = holding.look(0.0)
    assert start is not None
    holding.answered(start, rejected(Reason.JOINT_LIMIT), 0.1)
    assert (holding.wanted, holding.has_run, holding.takes_stop(), holding.is_stopped) == (None, False, False, True)


@pytest.mark.parametrize("theirs", [False, True])
def test_who_took_the_lease_has_stopped_the_leg_and_may_drive_it(theirs: bool) -> None:
    holding = Held()
    holding.failed(holding.due(), "lost", theirs=theirs)
    assert (holding.wanted, holding.fault, holding.takes_stop()) == (None, "lost", not theirs)
    again = Held()
    again.forget()
    assert (again.wanted, again.takes_stop(), again.owed) == (None, False, None)


class AnyOrder(RuleBasedStateMachine):
    """The gateway takes what is asked at once, or only when it answers, or never answers; Stops likewise."""

    def __init__(self) -> None:
        super().__init__()
        self.holding = Holding(0.0)
        self.now_s = 0.0
        self.running: set[int] = set()
        self.asked: Wanted | None = None
        self.ack: Ack | None = None
        self.pressed = False
        """A Stop is requested until it is confirmed."""

    def after(self) -> None:
        self.pressed |= self.holding.takes_stop()

    def take(self) -> None:
        if self.asked is not None and self.ack is None:
            if self.asked.op == "start":
                self.running.add(self.asked.servo_id)
            self.ack = TAKEN if self.asked.servo_id in self.running else rejected(Reason.SERVO_STOPPED)

    @rule(at_once=st.booleans())
    @precondition(lambda self: self.asked is None and not self.holding.wanted and not self.pressed)
    def start(self, at_once: bool) -> None:
        self.holding.start(32, 90.0, self.now_s)
        self.repeat(seen=True)
        if at_once:
            self.take()

    @rule(seen=st.booleans())
    @precondition(lambda self: self.asked is None)
    def repeat(self, seen: bool) -> None:
        self.now_s += 2 * UNSEEN_S
        if seen:
            self.holding.seen(self.now_s)
        self.asked, self.ack = self.holding.look(self.now_s), None
        self.after()

    @rule(all_legs=st.booleans())
    def stop(self, all_legs: bool) -> None:
        self.holding.stop(all_legs=all_legs)
        self.after()

    @rule(answer=st.sampled_from([None, TAKEN, rejected(Reason.STALE)]))
    @precondition(lambda self: self.asked is not None)
    def end(self, answer: Ack | None) -> None:
        assert self.asked is not None
        if answer is None or answer.accepted:
            self.take()
        if answer is None:
            self.holding.failed(self.asked, "no answer", theirs=False)
        else:
            self.holding.answered(self.asked, self.ack or answer, self.now_s)
        self.asked, self.ack = None, None
        self.after()

    @rule(answers=st.booleans())
    @precondition(lambda self: self.pressed)
    def stop_ends(self, answers: bool) -> None:
        owed = self.holding.owed
        if owed is not None:
            self.running = {servo_id for servo_id in self.running if owed not in (ALL_LEGS, servo_id // 10)}
        self.holding.stop_ended(None if answers else "no answer", more=False)
        self.pressed = not answers
        self.after()

    @invariant()
    def nothing_runs_that_is_neither_wanted_nor_owed_a_stop(self) -> None:
        if self.asked is None and not self.pressed:
            wanted = self.holding.wanted
            assert self.running <= (set() if wanted is None else {wanted.servo_id})
            assert wanted is not None or self.holding.is_stopped


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(max_examples=100, stateful_step_count=40)
