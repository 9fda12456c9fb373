"""What a terminal shows of a Stop that a key has requested, with the time as an argument; and how a picture is cut."""

import pytest
from rich.cells import cell_len
from rich.text import Text

from gateway.people.commands.walk.screen import SMALL_ROWS, fitted
from gateway.people.terminal.stop_status import PATIENCE_NS, SHOWN_NS, Remark, StopStatus
from schemas.telemetry import Ack

MS = 1_000_000
STOPPED = Ack(accepted=True, stop_frames=6, latency_us=812.4, estop=5)


def pressed(now_ns: int = 0) -> StopStatus:
    stop = StopStatus()
    stop.press(now_ns)
    return stop


def text(stop: StopStatus, now_ns: int) -> str:
    remark = stop.remark(now_ns)
    return "" if remark is None else remark.text


@pytest.mark.parametrize("ack", [Ack(accepted=True, stop_frames=5, latency_us=10), Ack(accepted=True)])
def test_a_stop_that_was_not_written_whole_is_an_alarm_that_stays(ack: Ack) -> None:
    stop = pressed()
    stop.confirm(ack, None, MS)
    remark = stop.remark(10 * SHOWN_NS)
    assert remark is not None
    assert remark.is_bad
    assert "switch the servos' power off" in remark.text


def test_a_stop_that_nobody_confirms_is_an_alarm_until_somebody_does() -> None:
    stop = pressed()
    assert stop.alarm(PATIENCE_NS - 1) is None
    assert stop.alarm(PATIENCE_NS) is not None, "before the request's own time is over"
    stop.unanswered()
    assert text(stop, MS).startswith("NOT STOPPED, NO ANSWER for 0 s: switch the servos' power off")
    assert "NO ANSWER for 60 s" in text(stop, 60_000 * MS)
    stop.press(60_500 * MS)
    assert "NO ANSWER for 61 s" in text(stop, 61_000 * MS), "another press does not begin anew"
    stop.confirm(STOPPED, None, 61_000 * MS)
    assert stop.alarm(61_000 * MS) is None
    assert text(stop, 61_000 * MS).endswith("confirmed 61000 ms after the key")


def test_an_answer_to_an_earlier_press_leaves_the_later_one_to_its_own() -> None:
    stop = pressed(1)
    stop.unanswered()
    stop.press(4 * MS)
    stop.confirm(STOPPED, 4 * MS, 5 * MS)
    assert stop.wanted_ns == 4 * MS
    assert stop.alarm(6 * MS) is None, "of the later one nothing has failed"
    assert text(stop, 6 * MS).startswith("EMERGENCY STOP sent")
    stop.confirm(STOPPED, None, 7 * MS)
    assert stop.wanted_ns is None
    assert text(stop, 7 * MS).endswith("confirmed 3 ms after the key")


def test_a_reset_takes_the_stop_back() -> None:
    stop = pressed()
    stop.unanswered()
    stop.reset()
    assert (stop.wanted_ns, text(stop, MS)) == (None, "")


# ---- a terminal that is too small


@pytest.mark.parametrize("columns", [2, 10, 80])
@pytest.mark.parametrize("rows", [1, 2, SMALL_ROWS - 1, SMALL_ROWS, 24])
@pytest.mark.parametrize("is_bad", [True, False])
def test_what_a_small_terminal_shows(columns: int, rows: int, is_bad: bool) -> None:
    """Its Stop key in the last row; but a Stop that is not confirmed goes before all else."""
    picture = fitted([Text("猫 and more")] * 30, columns, rows, Remark("NOT STOPPED", is_bad))
    shown = picture.plain.split("\n")
    assert len(shown) == rows
    assert max(map(cell_len, shown)) <= columns
    alarm, keys = " NOT STOPPED "[:columns], " SPACE or e: EMERGENCY STOP "[:columns]
    first = alarm if is_bad and rows < SMALL_ROWS else keys if rows == 1 else "猫 and more"[: columns - 1]
    assert shown[0].rstrip() == first.rstrip()
    assert shown[-1] == (keys if rows > 1 else first)
