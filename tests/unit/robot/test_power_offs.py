"""Which outputs the power board has confirmed to be off, and who hears of it when."""

from typing import Final

import pytest

from gateway.allowance import NS_PER_MS
from gateway.robot.power.offs import Confirmed, OutputsOff

CONFIRM_MS: Final = 150
ONE, LAST = 1, 1 << 17
BOTH: Final = ONE | LAST


@pytest.fixture
def offs() -> OutputsOff:
    return OutputsOff(CONFIRM_MS * NS_PER_MS)


def ns(ms: float) -> int:
    return round(ms * NS_PER_MS)


def test_what_is_to_be_on_is_no_longer_off(offs: OutputsOff) -> None:
    offs.take(BOTH, 1, ns(0))
    offs.feed(ONE | 2)
    assert (offs.mask, offs.unconfirmed) == (LAST, LAST)


def test_what_was_confirmed_off_and_is_on_again_is_returned(offs: OutputsOff) -> None:
    offs.take(BOTH, 1, ns(0))
    offs.answered(LAST, 1, ns(1))
    assert offs.answered(BOTH | 2, 1, ns(2))[0] == ONE, "not what was never confirmed, nor what may be on"


def test_each_that_is_not_confirmed_in_time_is_late(offs: OutputsOff) -> None:
    offs.take(BOTH, 1, ns(0))
    offs.take(2, 1, ns(1))
    assert offs.late(ns(CONFIRM_MS))[0] == BOTH


def test_an_output_is_late_to_the_nanosecond(offs: OutputsOff) -> None:
    offs.take(ONE, 1, ns(10))
    assert offs.late(ns(10 + CONFIRM_MS) - 1)[0] == 0
    assert offs.late(ns(10 + CONFIRM_MS))[0] == ONE
    offs.take(ONE, 2, ns(100))
    assert offs.late(ns(10 + CONFIRM_MS))[0] == ONE, "taken once more, it is due since the first time"
    offs.answered(0, 1, ns(200))
    assert offs.unconfirmed == ONE, "and is confirmed by the newer mask only"
    offs.answered(0, 2, ns(200))
    offs.take(ONE, 3, ns(300))
    assert offs.late(ns(300 + CONFIRM_MS) - 1)[0] == 0, "after a confirmation the time begins anew"
    assert offs.late(ns(300 + CONFIRM_MS))[0] == ONE


def test_who_waits_hears_of_the_confirmation_once(offs: OutputsOff) -> None:
    offs.take(ONE, 4, ns(0))
    offs.take(LAST, 5, ns(0))
    offs.wait(ONE, ns(-1), 31, newest=9)
    offs.wait(BOTH, ns(-2), 32, newest=9)
    assert offs.answered(0, 3, ns(6))[1] == []
    assert offs.answered(LAST, 5, ns(7))[1] == [Confirmed(31, True, 8.0)], "the other output is still on"
    assert offs.answered(0, 5, ns(8))[1] == [Confirmed(32, True, 10.0)]
    assert offs.answered(0, 6, ns(9))[1] == []
    assert offs.late(ns(1000))[1] == []


def test_a_wait_for_what_is_not_off_is_for_the_newest_mask(offs: OutputsOff) -> None:
    offs.wait(ONE, ns(0), 31, newest=9)
    assert offs.answered(0, 8, ns(1))[1] == []
    assert offs.answered(0, 9, ns(2))[1] == [Confirmed(31, True, 2.0)]


def test_who_waits_hears_in_time_that_it_is_not_confirmed(offs: OutputsOff) -> None:
    offs.take(ONE, 1, ns(0))
    offs.wait(ONE, ns(20), 31, newest=1)
    assert offs.late(ns(20 + CONFIRM_MS) - 1)[1] == []
    assert offs.late(ns(20 + CONFIRM_MS))[1] == [Confirmed(31, False, None)]
    assert offs.late(ns(1000))[1] == []


def test_whether_the_masks_that_took_some_have_reached_the_board(offs: OutputsOff) -> None:
    assert offs.have_reached(BOTH, 0), "none has to"
    offs.take(ONE, 4, ns(0))
    offs.take(LAST, 5, ns(0))
    assert [offs.have_reached(BOTH, reached) for reached in (3, 4, 5, 6)] == [False, False, True, True]
    assert [offs.have_reached(ONE, reached) for reached in (3, 4)] == [False, True]
