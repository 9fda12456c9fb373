"""The client's rules of time: how long a question waits, a stream's grid, a gateway's silence. In virtual time."""

import doctest
from types import ModuleType

import pytest

from gateway.errors import UnreachedError
from gateway.people.client import pace as pace_module
from gateway.people.client import payloads as payloads_module
from gateway.people.client.pace import MOST_DEG, RADIANS_S, Radians
from gateway.people.client.patience import ATTEMPT_S, OTHER_WAY_S, Patience, Query, QuestionStep
from gateway.people.commands.options import Reach
from gateway.people.console.link import GatewayLink
from gateway.people.console.pages.page_messages import Message, link_message
from gateway.people.watching import silence as silence_module
from gateway.people.watching.live import Receiver
from gateway.people.watching.silence import WHY_EVERY_S, Silence
from tests.support.published import state

END_S = 10.0


def asked(*, again: bool = True, other_ways: bool = False) -> tuple[Patience[str], Query[str]]:
    """A question that was sent at 0 s."""
    patience: Patience[str] = Patience(0.0, END_S, again=again, other_ways=other_ways)
    return patience, patience.sent(0.0)


def test_the_dialled_programs_answer_counts_at_once() -> None:
    patience, query = asked()
    assert patience.step(0.001) is QuestionStep.WAIT
    patience.replied(query, "own", own=True)
    patience.replied(query, "later", own=True)
    assert (patience.step(0.002), patience.answer) == (QuestionStep.OVER, "own")


def test_anothers_answer_is_better_than_none_in_the_end() -> None:
    patience, query = asked()
    assert patience.step(ATTEMPT_S) is QuestionStep.AGAIN
    patience.replied(query, "foreign", own=False)
    patience.replied(query, "later", own=False)
    assert patience.step(END_S) is QuestionStep.OVER
    assert patience.answer == "foreign"


def test_a_stop_without_an_answer_is_sent_again_each_second_until_its_end() -> None:
    patience, _ = asked()
    assert patience.next_s == ATTEMPT_S
    assert patience.step(ATTEMPT_S - 0.001) is QuestionStep.WAIT
    for number in range(1, 10):
        assert patience.step(number * ATTEMPT_S) is QuestionStep.AGAIN
        patience.sent(number * ATTEMPT_S)
        assert patience.step(number * ATTEMPT_S) is QuestionStep.WAIT
        assert patience.next_s == (number + 1) * ATTEMPT_S
    assert (patience.step(END_S), patience.answer) == (QuestionStep.OVER, None)


def test_while_another_query_is_under_way_a_lost_link_changes_nothing() -> None:
    patience, first = asked()
    patience.sent(0.1)
    patience.ended(first, 0.2)
    assert (patience.step(0.9), patience.next_s) == (QuestionStep.WAIT, ATTEMPT_S)


def test_what_is_no_stop_is_sent_once_and_ends_where_everybody_has_declined() -> None:
    patience, query = asked(again=False)
    assert patience.next_s == END_S
    assert patience.step(END_S - 0.001) is QuestionStep.WAIT
    patience.ended(query, 1.0)
    assert (patience.step(1.0), patience.answer) == (QuestionStep.OVER, None)
    assert asked(again=False)[0].step(END_S) is QuestionStep.OVER


def test_another_way_is_searched_for_once_and_at_once_if_the_link_is_lost() -> None:
    patience, _ = asked(other_ways=True)
    assert (patience.step(OTHER_WAY_S - 0.001), patience.next_s) == (QuestionStep.WAIT, OTHER_WAY_S)
    assert patience.step(OTHER_WAY_S) is QuestionStep.OTHER_WAY
    assert (patience.step(OTHER_WAY_S), patience.next_s) == (QuestionStep.WAIT, ATTEMPT_S)
    lost, query = asked(other_ways=True)
    lost.ended(query, 0.01)
    assert lost.step(0.01) is QuestionStep.OTHER_WAY
    assert lost.step(0.01) is QuestionStep.WAIT


def test_radians_are_suspected_once_and_never_of_a_program_that_has_sent_degrees() -> None:
    radians = Radians()
    found = [radians.suspected([(MOST_DEG, 0.0)], now_s) for now_s in (0.0, RADIANS_S, RADIANS_S + 1)]
    assert found == [False, True, False]
    degrees = Radians()
    assert not any(degrees.suspected([(angle,)], now_s) for angle, now_s in ((MOST_DEG + 0.01, 0), (1, 9), (1, 99)))
    late = Radians()
    late.suspected([(1.0,)], 0.0)
    late.suspected([(90.0,)], 0.1)
    assert not late.suspected([(1.0,)], RADIANS_S)


# ---- how long a gateway has published nothing, and what pages are shown of that


MS = 1_000_000


def opened() -> Silence:
    silence = Silence()
    silence.opened(0)
    return silence


def test_where_no_session_can_be_opened_it_is_looked_why_at_once() -> None:
    silence = Silence()
    silence.not_opened()
    assert silence.must_diagnose(0)
    silence = opened()
    silence.not_opened()  # the link broke before the session had its subscriptions: its second has begun
    assert not silence.must_diagnose(1000 * MS)


def test_each_look_costs_the_robot_something_and_so_has_three_seconds_before_it() -> None:
    silence = opened()
    looks = []
    for ms in range(0, 10_000, 100):
        if silence.must_diagnose(ms * MS):
            looks.append(ms)
            silence.diagnosed((ms + 500) * MS)  # so long did it take
    assert looks == [1100, 4600, 8100]
    silence.received(10_000 * MS)
    assert not silence.must_diagnose(10_500 * MS), "it is back"
    assert WHY_EVERY_S == 3


# ---- what pages are shown


CONNECTED = link_message("connected")


class Shown:
    """A link to no gateway, and what it shows."""

    def __init__(self) -> None:
        self.messages = [link_message("gone")]
        self.link = GatewayLink(Reach(None, None, 1.0), "console", Receiver(), self.messages.append)

    @property
    def newest(self) -> Message:
        return self.messages[-1]

    def receive_state(self) -> None:
        self.link.received_state(state(), 0)

    def connect(self) -> None:
        self.link.received_token(True)
        self.receive_state()
        assert self.newest == CONNECTED


async def test_until_the_first_state_nobody_is_there() -> None:
    shown = Shown()
    shown.link.not_opened(UnreachedError("nobody listens"))
    assert shown.newest == link_message("gone", "nobody listens")
    shown.link.diagnosed(["its port is closed", "it is off"])
    shown.link.not_opened(UnreachedError("nobody listens"))
    assert shown.newest == link_message("gone", "its port is closed\nit is off"), "which says more"
    shown.receive_state()
    assert shown.newest == CONNECTED


@pytest.mark.parametrize("linked", [True, False])
async def test_a_gateway_that_hangs_is_silent_and_a_link_that_is_cut_is_gone(linked: bool) -> None:
    shown = Shown()
    shown.connect()
    shown.link.fell_silent(linked=linked)
    assert shown.newest["status"] == ("silent" if linked else "gone")
    shown.link.diagnosed(["its journal says why"])
    shown.link.fell_silent(linked=linked)
    assert shown.newest["detail"] == "its journal says why", "what was found goes on being shown"
    assert len(shown.messages) == 4, "and the same is sent once"
    shown.receive_state()
    assert shown.newest == CONNECTED


async def test_a_gateway_that_has_ended_is_gone_at_once_and_no_older_state_brings_it_back() -> None:
    shown = Shown()
    shown.connect()
    shown.link.received_token(False)
    ended = link_message("gone", "the gateway has ended, or the link to it has")
    assert shown.newest == ended
    shown.receive_state()  # which was under way
    shown.link.fell_silent(linked=True)  # to a router
    assert shown.newest == ended
    shown.connect()


@pytest.mark.parametrize(("module", "count"), [(pace_module, 16), (payloads_module, 4), (silence_module, 5)])
def test_the_examples_are_right(module: ModuleType, count: int) -> None:
    assert doctest.testmod(module) == (0, count)
