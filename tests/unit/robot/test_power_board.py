"""What is sent to the power board, and what counts as confirmed: against the simulated board, in virtual time."""

import random

import pytest

from gateway.model.power_board import (
    ALL,
    ASK_CURRENTS,
    ASK_RAILS,
    CLEAR_ERROR,
    GOING_OFF,
    OFF_PRESSED,
    SET_SUPPLY,
    SUPPLIED,
    CanFrame,
    set_supply,
)
from gateway.rate_limit import NS_PER_MS
from gateway.robot.power.board import Confirmed, News, PowerBoard, Status, Then
from schemas.robot import SERVO_IDS
from schemas.telemetry import Kind
from tests.support.power_link import ALL_SERVOS, CONFIRM_MS, NONE, Link, fed

# ---- on


@pytest.mark.parametrize("pass_us", [1000, 1500, 2000])
@pytest.mark.parametrize("behind_ms", [1, 50, 100, 150, 300, 600])
def test_a_stop_while_others_are_switched_on_is_confirmed_in_time(pass_us: int, behind_ms: int) -> None:
    """The board answers a mask once all is on: all eighteen at once would take a second."""
    link = Link(pass_ns=1000 * pass_us, confirm_ms=450)
    link.want(NONE)
    link.run(700)
    link.want(ALL_SERVOS)
    link.run(behind_ms)
    link.want(ALL_SERVOS - {61, 62, 63})
    link.when_off(frozenset({61, 62, 63}))
    link.run(450)
    (confirmed,) = link.confirmations()
    assert confirmed.ms is not None
    assert link.events(Kind.POWER_UNCONFIRMED) == []
    link.run(1100)
    assert link.fed() == ALL_SERVOS - {61, 62, 63}


def test_outputs_go_on_six_at_a_time_in_their_order() -> None:
    link = at_rest()
    at_ns = link.now_ns
    link.want(ALL_SERVOS)
    link.run(700)
    masks = dict.fromkeys(frame for when_ns, frame in link.sent if when_ns >= at_ns and frame.id == SET_SUPPLY)
    assert list(masks) == [set_supply((1 << on) - 1) for on in (6, 12, 18)]


# ---- silence


def test_questions_do_not_flood_the_bus() -> None:
    link = fed()
    at_ns = link.now_ns
    link.run(1000)
    asked = [frame for when_ns, frame in link.sent if when_ns >= at_ns]
    assert len(asked) == pytest.approx(100, abs=2)
    assert sum(frame in ASK_CURRENTS for frame in asked) >= 80


# ---- Which masks the power board is sent, and when, where masks are lost or cross its answers: in virtual time


def at_rest() -> Link:
    """A link whose board has confirmed that all is off."""
    link = Link()
    link.want(NONE)
    link.run(300)
    assert link.ours.confirmed
    return link


def test_an_on_waits_for_the_answer_to_an_off_that_crossed_the_answer_before() -> None:
    """The counter is not at rest before: the on would be 230 passes late."""
    link = at_rest()
    link.want(frozenset({11}))
    answered_ms = link.run_until(lambda: link.ours.status.supplied == {11})
    link = at_rest()
    link.want(frozenset({11}))
    link.run(answered_ms - 1)
    at_ns = link.now_ns
    link.want(NONE)
    link.run(0.5)
    link.want(frozenset({12}))
    link.run(500)
    assert link.masks(at_ns)[0] == (0, 0)
    assert min(ms for ms, mask in link.masks(at_ns) if mask) > 30
    assert link.fed() == {12}


def test_not_even_the_first_off_is_confirmed_by_an_answer_that_was_on_its_way() -> None:
    ours = Link().ours
    ours.receive(CanFrame(ASK_CURRENTS[0].id + 1, bytes(6)), 0)
    ours.want(NONE, 0, 0)
    assert ours.next_frames(0)[0] == set_supply(0)
    ours.receive(CanFrame(SUPPLIED, bytes(3)), 1)
    assert not ours.confirmed


# ---- another node, and a second board


@pytest.fixture
def board() -> PowerBoard:
    return PowerBoard(SERVO_IDS, confirm_ns=CONFIRM_MS * NS_PER_MS)


def answer_to(question: CanFrame) -> CanFrame:
    return CanFrame(question.id + 1, bytes(6 if question.id in (0x7C, 0x80, 0x86) else 4))


def test_an_answer_to_another_nodes_question_confirms_nothing(board: PowerBoard) -> None:
    """That question was asked before our mask, which has not reached the board."""
    board.receive(CanFrame(0x97), 0)
    board.cut(0)
    then: Then = lambda _: None  # noqa: E731
    board.when_off(ALL_SERVOS, -10, then, 0)
    (asked,) = (frame for frame in board.next_frames(0) if frame in ASK_RAILS)
    board.receive(asked, 1)
    board.receive(answer_to(asked), 2)
    board.receive(CanFrame(0x6B, bytes(3)), 3)
    assert not board.confirmed
    board.receive(answer_to(asked), 4)
    board.receive(CanFrame(0x6B, bytes(3)), 5)
    assert board.confirmed, "the second answer is ours"
    assert board.news == [Confirmed(then, 15 / NS_PER_MS)]


def test_no_error_is_deleted_before_the_board_has_a_mask_without_what_it_blocks(board: PowerBoard) -> None:
    error = CanFrame(0x65, bytes.fromhex("02000001"))
    board.want(NONE, 1, 0)
    board.receive(error, 0)
    board.clear_errors(0)
    (asked,) = (frame for frame in board.next_frames(0) if frame in ASK_RAILS)
    board.receive(error, 1)
    assert CLEAR_ERROR not in board.next_frames(1)
    board.receive(answer_to(asked), 2)
    board.receive(error, 3)
    assert CLEAR_ERROR in board.next_frames(3)


def test_what_had_no_room_is_sent_again_at_once_and_nothing_else(board: PowerBoard) -> None:
    assert (Status().alive, Status().confirmed) == (False, False)
    board.receive(CanFrame(0x97), 0)
    board.cut(0)
    for now_ns in range(10):
        mask, question, *_ = frames = board.next_frames(now_ns)
        assert (mask, question in ASK_RAILS) == (set_supply(0), True)
        board.not_sent(frames[1:], now_ns)
        assert set_supply(0) not in board.next_frames(now_ns)
        board.not_sent([mask], now_ns)
    (asked,) = (frame for frame in board.next_frames(10) if frame in ASK_RAILS)
    board.receive(answer_to(asked), 11)
    board.receive(CanFrame(0x6B, bytes(3)), 12)
    assert board.confirmed


@pytest.mark.parametrize("seed", range(20))
def test_beside_a_node_that_asks_and_switches_nothing_is_confirmed_before_a_mask_has_arrived(seed: int) -> None:
    """Of what we send next to nothing reaches the board, for up to a second; we receive all."""
    chance = random.Random(seed)  # noqa: S311
    link, deaf_ms, reached = fed(), chance.randrange(1000), False
    ours, board, begun_ns = link.ours, link.board, link.now_ns
    ours.cut(begun_ns)
    for ms in range(2500):
        now_ns = begun_ns + ms * NS_PER_MS
        frames = [frame for frame in ours.next_frames(now_ns) if ms >= deaf_ms]
        reached = reached or any(frame.id == SET_SUPPLY for frame in frames)
        theirs = [chance.choice(ASK_RAILS)] if chance.random() < 0.2 else []
        theirs += [set_supply(chance.choice([0, ALL]))] if chance.random() < 0.02 and ms < 1500 else []
        for frame in theirs:
            ours.receive(frame, now_ns)
        for answer in [each for frame in (*frames, *theirs) for each in board.take(frame, now_ns)]:
            ours.receive(answer, now_ns)
        for answer in board.advance(now_ns):
            ours.receive(answer, now_ns)
        assert reached or not ours.confirmed
    assert ours.confirmed
    assert board.fed == 0


@pytest.mark.parametrize(("identifier", "words"), [(OFF_PRESSED, "pressed"), (GOING_OFF, "has asked")])
def test_what_is_reported_once_has_ended_after_a_second_without_its_frames(
    board: PowerBoard, identifier: int, words: str
) -> None:
    reported = []
    for at_ms in (0, 999, 1998, 2998):
        board.receive(CanFrame(identifier), at_ms * NS_PER_MS)
        reported += [(at_ms, words in news.detail) for news in board.news if isinstance(news, News)]
        board.news.clear()
    assert reported == [(0, True), (2998, True)]
