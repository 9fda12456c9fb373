"""Who waits for the power board: one question for all who ask within it, and no answer that is older than a Stop."""

from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.robot.power.offs import Confirmed
from gateway.robot.runtime.confirmations import MOST_ASKERS, MOST_QUESTIONS, Confirmations, Then
from schemas.robot import SERVO_IDS

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
