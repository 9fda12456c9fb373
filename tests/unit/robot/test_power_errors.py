"""The power board's errors: what they block, and how they are deleted."""

from typing import Final

import pytest

from gateway.allowance import NS_PER_MS
from gateway.model.power_board import (
    ALL,
    ASK_ERROR,
    CLEAR_ERROR,
    CONVERTER_OVERCURRENT,
    SERVO_OVERCURRENT,
    TWO_BOARDS,
    UNREADABLE,
    BoardError,
    CanFrame,
)
from gateway.robot.power.errors import BoardErrors

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


def test_nothing_is_deleted_unasked(errors: BoardErrors) -> None:
    errors.shown(FIRST, 0)
    assert errors.due_ns is None
    assert frames(errors, range(1000)) == []


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


def test_without_an_answer_it_asks_again_every_50_ms_for_two_seconds(errors: BoardErrors) -> None:
    errors.delete(0)
    assert frames(errors, range(1950)) == [(ms, ASK_ERROR) for ms in range(0, 1950, 50)]
    assert errors.due_ns is not None
    assert frames(errors, range(1950, 5000)) == [(1950, ASK_ERROR)]
    assert errors.due_ns is None


def test_what_another_program_has_deleted_is_not_deleted_again(errors: BoardErrors) -> None:
    errors.delete(0)
    errors.shown(FIRST, 0)
    errors.deleted(1 * NS_PER_MS)
    assert frames(errors, range(1, 10)) == [(1, ASK_ERROR)]


def test_an_answer_that_was_lost_does_not_delete_what_is_shown_next(errors: BoardErrors) -> None:
    errors.delete(0)
    errors.shown(FIRST, 0)
    assert frames(errors, range(60)) == [(0, CLEAR_ERROR), (50, ASK_ERROR)]


def test_none_is_deleted_while_the_board_may_feed_what_it_blocks(errors: BoardErrors) -> None:
    errors.delete(0)
    errors.shown(FIRST, 0)
    assert frames(errors, range(60), without=False) == [(50, ASK_ERROR)]
    errors.shown(FIRST, 60 * NS_PER_MS)
    assert frames(errors, range(60, 70)) == [(60, CLEAR_ERROR)]


def test_to_delete_anew_begins_with_a_question(errors: BoardErrors) -> None:
    errors.delete(0)
    errors.shown(FIRST, 0)
    errors.delete(5 * NS_PER_MS)
    assert frames(errors, range(10)) == [(5, ASK_ERROR)]


def test_an_error_that_cannot_be_read_blocks_all_and_is_reported_once(errors: BoardErrors) -> None:
    assert errors.shown(BoardError(UNREADABLE), 0)[1:] == (ALL, True)
    assert errors.shown(BoardError(UNREADABLE), 1)[1:] == (0, False)
    errors.deleted(2)
    assert errors.mask == 0


def test_two_boards_are_no_error_of_a_board_and_end_with_a_reset(errors: BoardErrors) -> None:
    assert errors.shown(BoardError(TWO_BOARDS), 0)[1:] == (ALL, True)
    errors.none_left()
    assert (errors.mask, errors.two_boards) == (ALL, True)
    errors.delete(1)
    assert (errors.mask, errors.two_boards) == (0, False)
