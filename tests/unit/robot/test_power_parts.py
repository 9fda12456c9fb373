"""Which question the power board is asked, and what an answer proves."""

from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Final, cast

import pytest

from gateway.model.power_board import (
    ASK_CURRENTS,
    ASK_ERROR,
    ASK_RAILS,
    CLEAR_ERROR,
    CanFrame,
)
from gateway.rate_limit import NS_PER_MS, NS_PER_S
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.power.board import Confirmed, Status, Then
from gateway.robot.power.line import PowerLine
from gateway.robot.power.questions import BoardErrors, BoardQuestions
from gateway.robot.runtime.supply import MOST_WAITING, Judged, RobotSupply, findings
from gateway.robot.spi import Wire
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
    asked = [question for number in range(10) for question in questions.about_rails(number, number)]
    assert sorted(asked) == sorted(ASK_RAILS)
    questions.answered_about_rails(asked[2], 0)
    assert (questions.reached, questions.reached_ns) == (2, 2)
    assert questions.about_rails(10, 10) == [asked[2]]
    # An answer that nobody asked for, or a second one, proves nothing.
    questions.answered_about_rails(asked[3], 0)
    questions.answered_about_rails(asked[3], 0)
    assert questions.reached == 3


def test_an_ask_is_lost_once_a_later_one_was_answered_or_after_2_s() -> None:
    questions = BoardQuestions()
    [first] = questions.about_rails(1, 0)
    for _ in range(5):
        [last] = questions.about_rails(1, NS_PER_MS)
    assert questions.about_rails(2, 1999 * NS_PER_MS) == []
    assert questions.about_rails(2, 2000 * NS_PER_MS) == [first]
    questions = BoardQuestions()
    [first] = questions.about_rails(1, 0)
    for number in range(5):
        [last] = questions.about_rails(1, number + 1)
    questions.answered_about_rails(last, 0)
    assert questions.about_rails(2, 299 * NS_PER_MS) == [last]
    assert questions.about_rails(2, 300 * NS_PER_MS) == [first]


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
    questions.answered(0)
    silent = [questions.silent(at_ms * NS_PER_MS) for at_ms in range(10, 120, 10)]
    assert silent == [False] * 10 + [True]
    assert questions.due_ns == 100 * NS_PER_MS, "and it is due since"


def test_while_the_board_is_likely_silent_rails_are_kept_for_when_it_answers() -> None:
    questions = asked_every_10_ms(5)
    assert questions.about_rails(1, 0) != []
    questions = asked_every_10_ms(6)
    assert questions.about_rails(1, 0) == []
    questions.answered(0)
    assert questions.about_rails(1, 0) != []


@pytest.mark.parametrize(("at_ms", "reached"), [(1999, 0), (2000, 1)])
def test_an_answer_is_for_another_node_that_asked_within_2_s(at_ms: int, reached: int) -> None:
    questions = BoardQuestions()
    [question] = questions.about_rails(1, 0)
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
        [question] = questions.about_rails(1, 0)
        for at_ns in (0, late_ns):
            questions.answered_about_rails(question, at_ns)
    assert questions.two_boards is two_boards
    for _ in range(2):
        questions.answered_about_rails(questions.about_rails(1, 0)[0], 0)
    assert (questions.doubles == 0) is not two_boards, "a question answered once ends the row, but not a fault"


# ---- The power board's errors: what they block, and how they are deleted


HOT: Final = dict.fromkeys((11, 12), "overtemperature")
DRAWN: Final = "overcurrent"


@pytest.fixture
def errors() -> BoardErrors:
    return BoardErrors()


def frames(errors: BoardErrors, at_ms: range, *, without: bool = True) -> list[tuple[int, CanFrame]]:
    """What leaves, with its time (ms)."""
    return [(ms, frame) for ms in at_ms for frame in errors.next_frames(ms * NS_PER_MS, without=without)]


def test_each_is_shown_and_then_deleted_until_the_board_has_none(errors: BoardErrors) -> None:
    errors.shown(2, {11: DRAWN}, 0)
    errors.shown(2, {63: DRAWN}, 0)
    errors.shown(4, HOT, 0)
    assert errors.blocked.keys() == {11, 12, 63}
    errors.deleted(0)
    errors.none_left()
    assert errors.blocked.keys() == {11, 12, 63}, "somebody at the board has deleted them"
    errors.delete(10 * NS_PER_MS)
    assert errors.due_ns == 10 * NS_PER_MS
    assert frames(errors, range(30)) == [(10, ASK_ERROR)]
    errors.shown(4, HOT, 30 * NS_PER_MS)
    assert frames(errors, range(30, 40)) == [(30, CLEAR_ERROR)]
    errors.deleted(40 * NS_PER_MS)
    assert frames(errors, range(40, 50)) == [(40, ASK_ERROR)]
    assert errors.blocked == {11: DRAWN, 63: DRAWN}
    errors.shown(2, {11: DRAWN}, 50 * NS_PER_MS)
    assert frames(errors, range(50, 60)) == [(50, CLEAR_ERROR)]
    errors.none_left()
    assert errors.blocked == {}
    assert errors.due_ns is None


def test_without_an_answer_it_asks_again_every_50_ms_for_two_seconds(errors: BoardErrors) -> None:
    errors.delete(0)
    errors.deleted(0)  # by another program
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
    errors.shown(2, {11: DRAWN}, 0)
    then(errors)
    assert frames(errors, range(60)) == left


def test_none_is_deleted_while_the_board_may_feed_what_it_blocks(errors: BoardErrors) -> None:
    errors.delete(0)
    errors.shown(2, {11: DRAWN}, 0)
    assert frames(errors, range(60), without=False) == [(50, ASK_ERROR)]
    errors.shown(2, {11: DRAWN}, 60 * NS_PER_MS)
    assert frames(errors, range(60, 70)) == [(60, CLEAR_ERROR)]


# ---- What currents say about Stops


CURRENTS: Final[dict[str, tuple[str, list[str]]]] = {
    # ms, the current of servo 11 in mA, and `!` while it runs; and at which of them it is reported
    "the second measurement 300 ms behind a Stop": ("0 151; 299 151; 300 151; 301 151; 302 151", ["301"]),
    "at rest it draws 150 mA at most": ("0 150; 400 150; 500 150", []),
    "a pause, and a single measurement": ("0 8; 400 900; 500 8; 600 900; 700 8", []),
    "again behind the next Stop": ("0 900; 400 900; 500 900; 600 900!; 700 9; 1100 900; 1200 900", ["500", "1200"]),
    "a second without any while it runs": ("7 4!; 8 0!; 1006 0!; 1007 0!; 1008 0!; 3000 0!", ["1007"]),
    "its electronics draw 5 mA": ("0 5!; 1000 5!; 2000 5!", []),
    "a pause begins the second anew": ("0 0!; 900 0!; 950 30!; 960 0!; 1900 0!; 1950 30!; 2000 900!", []),
}


@pytest.mark.parametrize(("measured", "reported"), CURRENTS.values(), ids=CURRENTS)
def test_what_a_servos_current_contradicts(measured: str, reported: list[str]) -> None:
    judged: dict[int, Judged] = {}
    found: list[str] = []
    for each in measured.split("; "):
        ms, ma = each.rstrip("!").split()
        runs = frozenset({11, 12} if "!" in each else ())
        for servo_id, kind, _ in findings(judged, {11: float(ma), 12: 100.0}, runs, int(ms) * NS_PER_MS):
            assert (servo_id, kind) == (11, Kind.SERVO_SILENT if runs else Kind.SERVO_DRAWS)
            found.append(ms)
    assert found == reported


# ---- Who waits for the power board


def test_some_wait_for_the_board_and_further_ones_learn_at_once_that_nothing_is_confirmed() -> None:
    asked: list[tuple[frozenset[int], int, Then, int]] = []
    board = SimpleNamespace(when_off=lambda *it: asked.append(it), want=lambda *_: None)
    line = SimpleNamespace(request=lambda act: act(board, 0), status=Status())
    supply = RobotSupply(cast(PowerLine, line), Supervisor(Rules(power=True)), cast(Wire, None))
    answers: dict[int, float | None] = {}
    for number in range(MOST_WAITING + 1):
        supply.confirm((11, 12), number, partial(answers.__setitem__, number))
    assert answers == {MOST_WAITING: None}
    assert [servos for servos, *_ in asked] == [frozenset({11, 12})] * MOST_WAITING
    supply.take_news([Confirmed(asked[7][2], 30.0), Confirmed(asked[8][2], None)])
    assert (answers[7], answers[8], len(answers)) == (30.0, None, 3)
    supply.close()
    assert (answers[7], len(answers)) == (30.0, MOST_WAITING + 1), "each learns it once"


def test_what_was_fed_before_the_latest_request_does_not_count() -> None:
    line = SimpleNamespace(request=lambda _: None, status=Status(alive=True, fed=frozenset({11})))
    supply = RobotSupply(cast(PowerLine, line), Supervisor(Rules(power=True)), cast(Wire, None))
    supply._trusted = True
    supply._ask(frozenset({11}))
    assert supply.take_news([])[0].fed == frozenset()
    line.status = line.status._replace(changes=1)
    assert supply.take_news([])[0].fed == {11}
