"""Which question the power board is asked, and what an answer proves."""

from collections.abc import Callable
from typing import Final

import pytest

from gateway.allowance import NS_PER_MS, NS_PER_S
from gateway.model.power_board import (
    ASK_CURRENTS,
    ASK_ERROR,
    ASK_RAILS,
    CLEAR_ERROR,
    CONVERTER_OVERCURRENT,
    SERVO_OVERCURRENT,
    TWO_BOARDS,
    BoardError,
    CanFrame,
)
from gateway.robot.power.board import News
from gateway.robot.power.currents import CurrentRules
from gateway.robot.power.errors import BoardErrors
from gateway.robot.power.offs import Confirmed, OutputsOff
from gateway.robot.power.questions import BoardQuestions
from gateway.robot.runtime.supply import MOST_ASKERS, MOST_QUESTIONS, Confirmations, Then
from schemas.robot import SERVO_IDS
from schemas.telemetry import Kind


def test_all_is_asked_in_turn_while_the_board_answers() -> None:
    questions = BoardQuestions()
    asked: list[CanFrame] = []
    for turn in range(14 * 6):
        [question] = questions.next(0, turn * 10 * NS_PER_MS)
        questions.answered(turn * 10 * NS_PER_MS)
        questions.answered_about_rails(question, 0)
        asked.append(question)
    assert [asked.count(question) for question in ASK_RAILS] == [1] * 6
    assert asked.count(ASK_ERROR) == 6
    assert {asked.count(question) for question in ASK_CURRENTS} == {12}


def test_a_question_with_an_unanswered_ask_proves_nothing_so_it_is_not_asked() -> None:
    questions = BoardQuestions()
    asked = [question for number in range(10) for question in questions.due_after(number, number)]
    assert sorted(asked) == sorted(ASK_RAILS)
    questions.answered_about_rails(asked[2], 0)
    assert (questions.reached, questions.reached_ns) == (2, 2)
    assert questions.due_after(10, 10) == [asked[2]]
    # An answer that nobody asked for, or a second one, proves nothing.
    questions.answered_about_rails(asked[3], 0)
    questions.answered_about_rails(asked[3], 0)
    assert questions.reached == 3


def test_an_ask_is_lost_once_a_later_one_was_answered_or_after_2_s() -> None:
    questions = BoardQuestions()
    [first] = questions.due_after(1, 0)
    for _ in range(5):
        [last] = questions.due_after(1, NS_PER_MS)
    assert questions.due_after(2, 1999 * NS_PER_MS) == []
    assert questions.due_after(2, 2000 * NS_PER_MS) == [first]
    questions = BoardQuestions()
    [first] = questions.due_after(1, 0)
    for number in range(5):
        [last] = questions.due_after(1, number + 1)
    questions.answered_about_rails(last, 0)
    assert questions.due_after(2, 299 * NS_PER_MS) == [last]
    assert questions.due_after(2, 300 * NS_PER_MS) == [first]


def test_a_new_interface_answers_no_older_question() -> None:
    questions = BoardQuestions()
    for _ in range(6):
        questions.due_after(1, 0)
    questions.opened(5)
    assert questions.due_ns == 5
    assert questions.due_after(2, 5) != []


def asked_every_10_ms(count: int) -> BoardQuestions:
    """The board answered at 1000 ms, and to none of these, of which the first left at 1000 ms."""
    questions = BoardQuestions()
    questions.answered(1000 * NS_PER_MS)
    for number in range(count):
        questions.next(0, (1000 + 10 * number) * NS_PER_MS)
    return questions


def test_the_board_is_silent_once_ten_questions_and_100_ms_went_by_without_an_answer() -> None:
    questions = asked_every_10_ms(10)
    assert not questions.silent(1100 * NS_PER_MS - 1)
    assert questions.silent(1100 * NS_PER_MS)
    questions.answered(1100 * NS_PER_MS)
    assert not questions.silent(1100 * NS_PER_MS)
    assert not asked_every_10_ms(9).silent(1100 * NS_PER_MS)


def test_a_question_that_nobody_fetched_for_20_ms_counts_as_unanswered() -> None:
    questions = BoardQuestions()
    questions.opened(0)
    questions.answered(0)
    silent = [questions.silent(at_ms * NS_PER_MS) for at_ms in range(10, 120, 10)]
    assert silent == [False] * 10 + [True]
    assert questions.due_ns == 100 * NS_PER_MS, "and it is due since"


def test_while_the_board_is_likely_silent_rails_are_kept_for_when_it_answers() -> None:
    questions = asked_every_10_ms(5)
    assert questions.due_after(1, 0) != []
    questions = asked_every_10_ms(6)
    assert questions.due_after(1, 0) == []
    questions.answered(0)
    assert questions.due_after(1, 0) != []


@pytest.mark.parametrize(("at_ms", "reached"), [(1999, 0), (2000, 1)])
def test_an_answer_is_for_another_node_that_asked_within_2_s(at_ms: int, reached: int) -> None:
    questions = BoardQuestions()
    [question] = questions.due_after(1, 0)
    questions.asked_by_another(question, NS_PER_S)
    questions.answered_about_rails(question, NS_PER_S + at_ms * NS_PER_MS)
    assert questions.reached == reached


@pytest.mark.parametrize(
    ("late_ns", "pairs", "two_boards"), [(10 * NS_PER_MS - 1, 3, True), (10 * NS_PER_MS, 3, False), (0, 2, False)]
)
def test_two_boards_answer_each_of_three_questions_twice_within_10_ms(
    late_ns: int, pairs: int, two_boards: bool
) -> None:
    questions = BoardQuestions()
    for _ in range(pairs):
        [question] = questions.due_after(1, 0)
        for at_ns in (0, late_ns):
            questions.answered_about_rails(question, at_ns)
    assert questions.two_boards is two_boards
    for _ in range(2):
        questions.answered_about_rails(questions.due_after(1, 0)[0], 0)
    assert questions.doubles == 0, "a question answered once ends the row"


# ---- The power board's errors: what they block, and how they are deleted


FIRST: Final = BoardError(SERVO_OVERCURRENT, 0b1)
LAST: Final = BoardError(SERVO_OVERCURRENT, 1 << 17)
WHY: Final = "overcurrent: the power board has switched these servos off"


@pytest.fixture
def errors() -> BoardErrors:
    return BoardErrors()


def frames(errors: BoardErrors, at_ms: range, *, without: bool = True) -> list[tuple[int, CanFrame]]:
    """What leaves, with its time (ms)."""
    left = ((ms, errors.next_frame(ms * NS_PER_MS, without=without)) for ms in at_ms)
    return [(ms, frame) for ms, frame in left if frame is not None]


def test_an_error_blocks_its_outputs_and_is_news_once(errors: BoardErrors) -> None:
    assert errors.mask == 0
    assert errors.shown(FIRST, 0) == (WHY, 0b1, True)
    assert errors.shown(FIRST, 1) == (WHY, 0, False)
    assert errors.shown(LAST, 2) == (WHY, 1 << 17, True)
    assert errors.blocked == {0: WHY, 17: WHY}
    assert errors.mask == 1 | 1 << 17
    other_way = BoardErrors()
    assert [other_way.shown(each, 0)[2] for each in (LAST, FIRST, LAST)] == [True, True, False]


def test_each_is_shown_and_then_deleted_until_the_board_has_none(errors: BoardErrors) -> None:
    first = BoardError(CONVERTER_OVERCURRENT, 0b1)
    errors.shown(first, 0)
    errors.shown(LAST, 0)
    errors.delete(10 * NS_PER_MS)
    assert errors.due_ns == 10 * NS_PER_MS
    assert frames(errors, range(30)) == [(10, ASK_ERROR)]
    errors.shown(LAST, 30 * NS_PER_MS)
    assert frames(errors, range(30, 40)) == [(30, CLEAR_ERROR)]
    errors.deleted(40 * NS_PER_MS)
    assert frames(errors, range(40, 50)) == [(40, ASK_ERROR)]
    errors.shown(first, 50 * NS_PER_MS)
    assert frames(errors, range(50, 60)) == [(50, CLEAR_ERROR)]
    assert errors.mask == 0b111111
    errors.deleted(60 * NS_PER_MS)
    assert errors.mask == 0, "each is free again with its own error"
    errors.none_left()
    assert errors.mask == 0
    assert errors.due_ns is None
    assert errors.shown(FIRST, 70 * NS_PER_MS)[2], "what comes again is news again"


def test_a_board_without_errors_blocks_nothing_and_two_boards_are_no_error_of_one(errors: BoardErrors) -> None:
    two = BoardError(TWO_BOARDS, 0)
    errors.shown(FIRST, 0)
    errors.shown(two, 0)
    errors.none_left()
    assert errors.two_boards
    assert not errors.shown(two, 1)[2]
    errors.delete(2)
    assert (errors.two_boards, errors.mask) == (False, 0)
    assert errors.shown(two, 3)[2]
    assert errors.shown(FIRST, 3)[2]


def test_without_an_answer_it_asks_again_every_50_ms_for_two_seconds(errors: BoardErrors) -> None:
    errors.delete(0)
    assert frames(errors, range(1950)) == [(ms, ASK_ERROR) for ms in range(0, 1950, 50)]
    assert errors.due_ns is not None
    assert frames(errors, range(1950, 5000)) == [(1950, ASK_ERROR)]
    assert errors.due_ns is None


@pytest.mark.parametrize(
    ("then", "left"),
    [
        (lambda _: None, [(0, CLEAR_ERROR), (50, ASK_ERROR)]),
        (lambda errors: errors.deleted(NS_PER_MS), [(1, ASK_ERROR), (51, ASK_ERROR)]),
        (lambda errors: errors.delete(5 * NS_PER_MS), [(5, ASK_ERROR), (55, ASK_ERROR)]),
    ],
    ids=["its answer was lost", "another program has deleted it", "deleting begins anew"],
)
def test_what_was_shown_is_deleted_once(
    errors: BoardErrors, then: Callable[[BoardErrors], None], left: list[tuple[int, CanFrame]]
) -> None:
    errors.delete(0)
    errors.shown(FIRST, 0)
    then(errors)
    assert frames(errors, range(60)) == left


def test_none_is_deleted_while_the_board_may_feed_what_it_blocks(errors: BoardErrors) -> None:
    errors.delete(0)
    errors.shown(FIRST, 0)
    assert frames(errors, range(60), without=False) == [(50, ASK_ERROR)]
    errors.shown(FIRST, 60 * NS_PER_MS)
    assert frames(errors, range(60, 70)) == [(60, CLEAR_ERROR)]


# ---- Which outputs the power board has confirmed to be off, and who hears of it when


CONFIRM_MS: Final = 150
NONE: Final = frozenset[int]()
ONE, TWO, TOP = frozenset({11}), frozenset({12}), frozenset({63})
BOTH: Final = ONE | TOP


@pytest.fixture
def offs() -> OutputsOff:
    return OutputsOff(CONFIRM_MS * NS_PER_MS)


def ns(ms: float) -> int:
    return round(ms * NS_PER_MS)


def test_each_that_is_not_confirmed_in_time_is_late(offs: OutputsOff) -> None:
    offs.take(BOTH, 1, ns(0))
    offs.take(TWO, 1, ns(1))
    assert offs.late(ns(CONFIRM_MS))[0] == BOTH


def test_who_waits_hears_of_the_confirmation_once(offs: OutputsOff) -> None:
    offs.take(ONE, 4, ns(0))
    offs.take(TOP, 5, ns(0))
    offs.wait(ONE, ns(-1), 31, newest=9)
    offs.wait(BOTH, ns(-2), 32, newest=9)
    assert offs.answered(NONE, 3, ns(6))[1] == []
    assert offs.answered(TOP, 5, ns(7))[1] == [Confirmed(31, True, 8.0)], "the other output is still on"
    assert offs.answered(NONE, 5, ns(8))[1] == [Confirmed(32, True, 10.0)]
    assert offs.answered(NONE, 6, ns(9))[1] == []
    assert offs.late(ns(1000))[1] == []


def test_a_wait_for_what_is_not_off_is_for_the_newest_mask(offs: OutputsOff) -> None:
    offs.wait(ONE, ns(0), 31, newest=9)
    assert offs.answered(NONE, 8, ns(1))[1] == []
    assert offs.answered(NONE, 9, ns(2))[1] == [Confirmed(31, True, 2.0)]


def test_whether_the_masks_that_took_some_have_reached_the_board(offs: OutputsOff) -> None:
    assert offs.have_reached(BOTH, 0), "none has to"
    offs.take(ONE, 4, ns(0))
    offs.take(TOP, 5, ns(0))
    assert [offs.have_reached(BOTH, reached) for reached in (3, 4, 5, 6)] == [False, False, True, True]
    assert [offs.have_reached(ONE, reached) for reached in (3, 4)] == [False, True]


# ---- What currents say about Stops


class Robot:
    """Servo 11 (and what else is given), measured every 65 ms, as the board's questions go round."""

    def __init__(self) -> None:
        self.rules = CurrentRules()
        self.now_ns = 0

    def measure(self, ma: float, *, ms: float, runs: bool) -> list[News]:
        news: list[News] = []
        end_ns = self.now_ns + round(ms * NS_PER_MS)
        while self.now_ns < end_ns:
            news += self.rules.measured({11: ma, 12: 100.0}, frozenset({11, 12} if runs else NONE), self.now_ns)
            self.now_ns += 65 * NS_PER_MS
        return news


def test_a_stopped_servo_that_still_draws_is_named_once_and_again_after_the_next_stop() -> None:
    robot = Robot()
    assert robot.measure(900, ms=2000, runs=True) == []
    [news] = robot.measure(900, ms=3000, runs=False)
    assert news == News(Kind.SERVO_DRAWS, "servo 11 is stopped and draws 900 mA, more than 150 mA", frozenset({11}))
    robot.measure(900, ms=200, runs=True)
    assert len(robot.measure(900, ms=3000, runs=False)) == 1


def test_a_stopped_servo_may_draw_while_it_settles_and_no_more_than_idle_after() -> None:
    robot = Robot()
    robot.measure(900, ms=500, runs=True)
    assert robot.measure(900, ms=300, runs=False) == []
    assert robot.measure(150, ms=5000, runs=False) == []


@pytest.mark.parametrize(("ma", "ms", "events"), [(0, 900, 0), (0, 3000, 1), (4, 3000, 1), (5, 3000, 0), (8, 3000, 0)])
def test_a_servo_that_runs_and_draws_nothing_for_a_second_is_named_once(ma: float, ms: float, events: int) -> None:
    news = Robot().measure(ma, ms=ms, runs=True)
    assert [item.kind for item in news] == [Kind.SERVO_SILENT] * events
    assert all(item.servos == {11} for item in news)


def test_a_pause_of_its_silence_begins_the_second_anew() -> None:
    robot = Robot()
    for _ in range(5):
        assert robot.measure(0, ms=900, runs=True) == []
        assert robot.measure(30, ms=1, runs=True) == []


def test_the_second_measurement_behind_the_time_to_settle_takes_the_supply() -> None:
    rules = CurrentRules()
    end_ns = 300 * NS_PER_MS
    early = [rules.measured({11: 151.0}, NONE, at_ns) for at_ns in range(0, end_ns, 10 * NS_PER_MS)]
    assert not any(early)
    assert rules.measured({11: 151.0}, NONE, end_ns) == []
    assert [each.kind for each in rules.measured({11: 151.0}, NONE, end_ns + 1)] == [Kind.SERVO_DRAWS]


def test_a_servo_that_draws_nothing_is_silent_after_a_second() -> None:
    rules, running = CurrentRules(), frozenset({11})
    found = [rules.measured({11: 0.0}, running, at_ms * NS_PER_MS) for at_ms in (7, 8, 1006, 1007, 1008)]
    assert [len(news) for news in found] == [0, 0, 0, 1, 0]


# ---- Who waits for the power board: one question for all who ask within it, and no answer that is older than a Stop


LEG_1: Final = frozenset({11, 12, 13})


class Asked:
    """Questions to a board, and what askers learn."""

    def __init__(self) -> None:
        self.questions: list[tuple[frozenset[int], int, int]] = []
        self.answers: dict[str, tuple[bool, float | None]] = {}
        self.confirmations = Confirmations(lambda *question: self.questions.append(question))

    def then(self, name: str) -> Then:
        def learn(confirmed: bool, ms: float | None) -> None:
            assert name not in self.answers, "once"
            self.answers[name] = confirmed, ms

        return learn

    def ask(self, name: str, at_ms: int, servos: frozenset[int] = LEG_1) -> None:
        self.confirmations.wait(servos, at_ms * NS_PER_MS, self.then(name))


def test_an_answer_that_is_older_than_a_stop_does_not_confirm_it() -> None:
    """The board's answer waits for the owner of the state, who takes the next Stop first."""
    asked = Asked()
    asked.ask("first", 100)
    asked.ask("second", 140)
    asked.confirmations.answered(Confirmed(asked.questions[0][2], confirmed=True, ms=30.0))
    assert asked.answers == {"first": (True, 30.0)}
    servos, asked_ns, token = asked.questions[1]
    assert (servos, asked_ns) == (LEG_1, 140 * NS_PER_MS)
    asked.confirmations.answered(Confirmed(token, confirmed=True, ms=5.0))
    assert asked.answers["second"] == (True, 5.0)


def test_servos_that_are_fed_meanwhile_need_a_question_of_their_own() -> None:
    asked = Asked()
    asked.ask("first", 100)
    asked.confirmations.feeds(frozenset({21}))
    asked.ask("second", 101)
    assert len(asked.questions) == 1
    asked.confirmations.feeds(frozenset({12}))
    asked.ask("third", 102)
    assert len(asked.questions) == 2


def test_few_wait_and_further_ones_learn_at_once_that_nothing_is_confirmed() -> None:
    asked = Asked()
    for number in range(MOST_ASKERS + 1):
        asked.ask(str(number), number)
    assert asked.answers == {str(MOST_ASKERS): (False, None)}
    for number in range(MOST_QUESTIONS):
        asked.confirmations.feeds(LEG_1)
        asked.ask(f"question {number}", 0)
    assert len(asked.questions) == MOST_QUESTIONS
    assert asked.answers[f"question {MOST_QUESTIONS - 1}"] == (False, None)
    asked.confirmations.close()
    assert len(asked.answers) == MOST_ASKERS + 1 + MOST_QUESTIONS
    assert set(asked.answers.values()) == {(False, None)}


def test_each_leg_each_servo_and_the_whole_robot_may_be_asked_about_at_a_time() -> None:
    assert 6 + len(SERVO_IDS) + 1 <= MOST_QUESTIONS
