"""Which question the power board is asked, and what an answer proves."""

from gateway.allowance import NS_PER_MS
from gateway.model.power_board import ASK_CURRENTS, ASK_ERROR, ASK_RAILS, CanFrame
from gateway.robot.power.questions import BoardQuestions


def test_at_first_a_question_is_due_and_no_mask_has_reached_the_board() -> None:
    questions = BoardQuestions()
    assert (questions.due_ns, questions.reached, questions.reached_ns) == (0, 0, 0)


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


def test_a_board_that_was_never_heard_is_silent_after_ten_questions_too() -> None:
    questions = BoardQuestions()
    for number in range(9):
        questions.next(0, (1000 + 10 * number) * NS_PER_MS)
    assert not questions.silent(1085 * NS_PER_MS)
    questions.next(0, 1090 * NS_PER_MS)
    assert questions.silent(1090 * NS_PER_MS)


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


def test_an_answer_to_what_was_never_asked_proves_nothing() -> None:
    questions = BoardQuestions()
    questions.answered_about_rails(ASK_RAILS[0], 0)
    assert (questions.reached, questions.reached_ns) == (0, 0)
