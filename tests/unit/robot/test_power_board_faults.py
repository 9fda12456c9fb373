"""Others that switch through the power board, and its own faults: against the simulated one, in virtual time."""

import pytest

from gateway.allowance import NS_PER_MS
from gateway.model.power_board import (
    ASK_RAILS,
    CanFrame,
    set_supply,
)
from gateway.robot.power.board import News, PowerBoard
from gateway.robot.power.offs import Confirmed
from gateway.simulation.board import SimulatedBoard
from schemas.robot import SERVO_IDS
from schemas.telemetry import Kind
from tests.support.power_link import ALL_SERVOS, CONFIRM_MS, NONE, fed

# ---- others that switch


def test_a_node_that_floods_masks_is_answered_at_a_pace_and_reported_once_a_second() -> None:
    link = fed()
    at_ns = link.now_ns
    for _ in range(8000):
        link.other_node(0)
        link.run(0.125)
    assert len(link.masks(at_ns)) <= 250
    assert len(link.events(Kind.POWER_FAULT)) <= 2


# ---- the board's own faults


def test_an_error_is_deleted_only_once_the_board_has_the_mask_without_its_servos() -> None:
    link = fed()
    link.board.fail(2, 1)
    link.run_until(lambda: link.ours.status.refused != {})
    link.ours.clear_errors(link.now_ns)
    at_ns = link.now_ns
    link.run(100)
    sent = [frame.id for when_ns, frame in link.sent if when_ns >= at_ns]
    assert 0x96 in sent
    assert sent.index(0x6A) < sent.index(0x96)
    assert link.fed() == ALL_SERVOS - {11}


# ---- another node, and a second board


def test_an_answer_to_another_nodes_question_confirms_nothing() -> None:
    """That question was asked before our mask, which has not reached the board."""
    board = PowerBoard(SERVO_IDS, confirm_ns=CONFIRM_MS * NS_PER_MS)
    board.receive(CanFrame(0x97), 0)
    board.cut(0)
    asked = [frame for frame in board.next_frames(0) if frame in ASK_RAILS]
    assert len(asked) == 1
    answer = CanFrame(asked[0].id + 1, bytes(6 if asked[0].id in (0x7C, 0x80, 0x86) else 4))
    board.receive(asked[0], 1)
    board.receive(answer, 2)
    board.receive(CanFrame(0x6B, bytes(3)), 3)
    assert not board.confirmed
    board.receive(answer, 4)
    board.receive(CanFrame(0x6B, bytes(3)), 5)
    assert board.confirmed, "the second answer is ours"


@pytest.mark.parametrize("hz", [1, 7, 50, 200])
def test_beside_a_node_that_asks_all_the_time_stops_are_confirmed_and_it_is_no_second_board(hz: int) -> None:
    link = fed()
    for number in range(hz):
        link.run(1000 / hz)
        question = ASK_RAILS[number % len(ASK_RAILS)]
        link.ours.receive(question, link.now_ns)
        link._answered(link.board.take(question, link.now_ns))
    assert link.events(Kind.POWER_FAULT) == []
    link.cut()
    link.run(400)
    assert link.ours.confirmed


def test_two_boards_on_one_bus_are_a_fault_and_confirm_nothing_until_a_reset() -> None:
    link = fed()
    second = SimulatedBoard(link.now_ns)
    take, advance = link.board.take, link.board.advance
    link.board.take = lambda frame, now_ns: [*take(frame, now_ns), *second.take(frame, now_ns)]  # type: ignore[method-assign]
    link.board.advance = lambda now_ns: [*advance(now_ns), *second.advance(now_ns)]  # type: ignore[method-assign]
    link.run(1000)
    [(_, news)] = link.events(Kind.POWER_FAULT)
    assert (news.servos, "two power boards" in news.detail) == (ALL_SERVOS, True)
    assert set(link.ours.status.refused) == ALL_SERVOS
    # The real one is unplugged, and feeds what it fed.
    link.board = second
    link.cut()
    link.when_off(ALL_SERVOS, token=1)
    link.run(1000)
    assert not link.ours.confirmed
    assert list(link.confirmations()) == [Confirmed(1, False, None)]
    link.want(NONE)
    link.ours.clear_errors(link.now_ns)
    link.run(1000)
    assert link.ours.confirmed
    assert link.ours.status.refused == {}


@pytest.mark.parametrize("frame", ["69", "67", "6508", "650420"])
def test_a_frame_that_is_repeated_4000_times_a_second_is_one_announcement(frame: str) -> None:
    link = fed()
    data = bytes.fromhex(frame)
    for _ in range(4000):
        link.ours.receive(CanFrame(data[0], data[1:]), link.now_ns)
        link.run(0.25)
    kinds = [item.kind for _, item in link.news if isinstance(item, News)]
    assert len(kinds) == 1
    link.run(1000)
    link.ours.receive(CanFrame(data[0], data[1:]), link.now_ns)
    link.run(100)
    assert len([item for _, item in link.news if isinstance(item, News)]) == 2, "it had ended"


def test_a_mask_for_which_there_was_no_room_leaves_first_and_is_confirmed_by_no_question_of_before() -> None:
    board = PowerBoard(SERVO_IDS, confirm_ns=CONFIRM_MS * NS_PER_MS)
    board.receive(CanFrame(0x97), 0)
    board.cut(0)
    refused = board.next_frames(0)
    assert refused[0] == set_supply(0)
    board.not_sent(refused, 1)
    again = board.next_frames(2)
    assert again[0] == set_supply(0), "it is not waited for the next repeat"
    (asked,) = (frame for frame in again if frame in ASK_RAILS)
    board.receive(CanFrame(asked.id + 1, bytes(6 if asked.id in (0x7C, 0x80, 0x86) else 4)), 3)
    board.receive(CanFrame(0x6B, bytes(3)), 4)
    assert board.confirmed
