"""What a terminal shows of a Stop that a key has requested, with the time as an argument; and how a picture is cut."""

from queue import SimpleQueue

import pytest
from rich.cells import cell_len
from rich.text import Text

from gateway.errors import DisconnectedError
from gateway.people.client.confirmed_stop import UntilConfirmed
from gateway.people.client.dangers import KEY_PATIENCE_NS, SHOWN_NS, Remark, StopStatus
from gateway.people.commands.walk.screen import SMALL_ROWS, fitted
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
    assert stop.alarm(KEY_PATIENCE_NS - 1) is None
    assert stop.alarm(KEY_PATIENCE_NS) is not None, "before the request's own time is over"
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
    alarm, keys = " NOT STOPPED "[:columns], " SPACE or ESC: EMERGENCY STOP "[:columns]
    first = alarm if is_bad and rows < SMALL_ROWS else keys if rows == 1 else "猫 and more"[: columns - 1]
    assert shown[0].rstrip() == first.rstrip()
    assert shown[-1] == (keys if rows > 1 else first)


# ---- requested until it is confirmed


WRITTEN = Ack(accepted=True, stop_frames=6, latency_us=800.0)
LATE_S = 10


class Gateway:
    """Answers when the test says so; each request is of another thread."""

    def __init__(self) -> None:
        self.wanted = True
        self.requests: SimpleQueue[SimpleQueue[Ack | Exception]] = SimpleQueue()
        self.noted: SimpleQueue[Ack | Exception] = SimpleQueue()
        self.stops = UntilConfirmed(self._estop, self._note)

    def asked(self) -> "SimpleQueue[Ack | Exception]":
        return self.requests.get(timeout=LATE_S)

    def pressed(self) -> "SimpleQueue[Ack | Exception]":
        self.stops.press()
        return self.asked()

    def _estop(self) -> Ack:
        answer: SimpleQueue[Ack | Exception] = SimpleQueue()
        self.requests.put(answer)
        outcome = answer.get()
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def _note(self, outcome: Ack | Exception) -> bool:
        self.noted.put(outcome)
        if isinstance(outcome, MemoryError):
            raise outcome
        return self.wanted


def test_it_is_requested_again_until_it_is_confirmed_whatever_goes_wrong() -> None:
    gateway = Gateway()
    gateway.stops.press()
    faults: list[Ack | Exception] = [
        MemoryError(),
        RuntimeError("can't start new thread"),
        DisconnectedError("no answer"),
    ] * 2
    for outcome in (*faults, WRITTEN):
        gateway.asked().put(outcome)
        assert gateway.noted.get(timeout=LATE_S) is outcome
    assert gateway.stops.since_ns is None


def test_what_nobody_wants_any_more_is_not_requested_again_and_the_next_press_is() -> None:
    gateway = Gateway()
    gateway.wanted = False
    gateway.pressed().put(DisconnectedError("no answer"))
    assert isinstance(gateway.noted.get(timeout=LATE_S), DisconnectedError)
    earlier, later = gateway.pressed(), gateway.pressed()
    earlier.put(DisconnectedError("no answer"))
    assert isinstance(gateway.noted.get(timeout=LATE_S), DisconnectedError)
    later.put(WRITTEN)
    assert gateway.noted.get(timeout=LATE_S) is WRITTEN, "it was pressed after what nobody wants"
    first = gateway.pressed()
    gateway.stops.take_back()
    assert gateway.stops.since_ns is None
    second = gateway.pressed()
    first.put(DisconnectedError("from before the reset"))
    second.put(WRITTEN)
    assert gateway.noted.get(timeout=LATE_S) is WRITTEN
