"""What means danger, and a Stop that is pressed until it is confirmed, in virtual time."""

import re
import time
from pathlib import Path
from queue import SimpleQueue
from typing import cast

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, consumes, invariant, precondition, rule
from rich.cells import cell_len
from rich.text import Text

from gateway.errors import DisconnectedError, UnansweredError
from gateway.people.commands.send import command_report, estop_report
from gateway.people.commands.walk.screen import SMALL_ROWS, fitted
from gateway.people.console.pages.pages import Page, Pages
from gateway.people.watching.confirmed_stop import (
    AGAIN_NS,
    MAX_PRESSES,
    REQUESTS_AT_ONCE,
    ConfirmedStop,
    Press,
    StopRequest,
    UntilConfirmed,
)
from gateway.people.watching.dangers import (
    KEY_PATIENCE_NS,
    PATIENCE_NS,
    SHOWN_NS,
    UNCONFIRMED,
    PowerAlarm,
    Remark,
    StopStatus,
    confirmed_off,
    power_now,
    tone_of,
)
from schemas.ack import Ack
from schemas.gateway_state import GatewayState, PowerReport
from schemas.words import Kind, Mode
from tests.support.published import event, state
from tests.unit.people.test_console_pages import OpenPage

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


# ---- a terminal that is too small


@pytest.mark.parametrize("columns", [2, 10, 80])
@pytest.mark.parametrize("rows", [1, 2, SMALL_ROWS - 1, SMALL_ROWS, 24])
@pytest.mark.parametrize("is_bad", [True, False])
def test_what_a_small_terminal_shows(columns: int, rows: int, is_bad: bool) -> None:
    """Its Stop key in the last row; but a Stop that is not confirmed goes before all else."""
    shown = fitted([Text("猫 and more")] * 30, columns, rows, Remark("NOT STOPPED", is_bad)).plain.split("\n")
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
        self.requests: SimpleQueue[SimpleQueue[Ack | Exception]] = SimpleQueue()
        self.changes: SimpleQueue[None] = SimpleQueue()
        self.key = UntilConfirmed(self._estop, lambda: self.changes.put(None))

    def asked(self) -> "SimpleQueue[Ack | Exception]":
        return self.requests.get(timeout=LATE_S)

    def pressed(self) -> "SimpleQueue[Ack | Exception]":
        self.key.press()
        self.changes.get(timeout=LATE_S)
        return self.asked()

    def answer(self, request: "SimpleQueue[Ack | Exception]", outcome: Ack | Exception) -> str:
        request.put(outcome)
        self.changes.get(timeout=LATE_S)
        return text(self.key.status, time.monotonic_ns())

    def _estop(self) -> Ack:
        answer: SimpleQueue[Ack | Exception] = SimpleQueue()
        self.requests.put(answer)
        outcome = answer.get()
        if isinstance(outcome, Exception):
            raise outcome
        return outcome


def test_a_stop_is_requested_again_until_it_is_confirmed_whatever_goes_wrong() -> None:
    gateway = Gateway()
    faults: list[Exception] = [MemoryError(), RuntimeError("can't start new thread"), DisconnectedError("no answer")]
    request = gateway.pressed()
    for fault in faults * 2:
        assert gateway.answer(request, fault).startswith("NOT STOPPED, NO ANSWER")
        request = gateway.asked()
    assert gateway.answer(request, WRITTEN).startswith("STOPPED")
    assert gateway.key.status.wanted_ns is None


def test_what_nobody_wants_any_more_is_not_requested_again_and_the_next_press_is() -> None:
    gateway = Gateway()
    earlier, later = gateway.pressed(), gateway.pressed()
    assert gateway.answer(earlier, DisconnectedError("no answer")).startswith("NOT STOPPED")
    gateway.key.take_back()
    gateway.changes.get(timeout=LATE_S)
    assert gateway.key.remark(0) is None
    assert gateway.answer(later, DisconnectedError("from before the reset")) == ""
    assert gateway.answer(gateway.pressed(), WRITTEN).startswith("STOPPED"), "it was pressed after the reset"
    assert gateway.requests.empty()


# ---- a Stop that the power board does not confirm, and events


OFF = PowerReport(interface="slcan", alive=True, confirmed=True, age_ms=4.0)
FED = OFF.model_copy(update={"supplied": tuple(range(18))})
DOUBTED = FED.model_copy(update={"confirmed": False})
SILENT = DOUBTED.model_copy(update={"alive": False, "age_ms": 450.0})
STANDS_BY = PowerReport(interface="slcan", alive=False)


def of(power: PowerReport | None, mode: Mode = Mode.ACTIVE) -> GatewayState:
    return state(mode=mode).model_copy(update={"power": power})


def alarm_after(*found: tuple[int, PowerReport | None], mode: Mode = Mode.ACTIVE) -> str:
    alarm = PowerAlarm()
    for at_ns, power in found:
        alarm.received_state(of(power, mode), at_ns)
    return alarm.sentence


def test_a_state_while_the_board_answers_is_no_alarm_but_two_without_a_confirmation_are() -> None:
    assert alarm_after((0, DOUBTED)) == ""
    assert alarm_after((0, DOUBTED), (PATIENCE_NS - 1, DOUBTED)) == ""
    assert alarm_after((0, DOUBTED), (100 * MS, OFF), (PATIENCE_NS, DOUBTED)) == "", "each cut has its own time"
    assert alarm_after((0, DOUBTED), (PATIENCE_NS, DOUBTED)) == UNCONFIRMED
    # one that never answered, in an emergency stop alone
    assert alarm_after((0, STANDS_BY), (10 * PATIENCE_NS, STANDS_BY)) == ""
    assert alarm_after((0, STANDS_BY), mode=Mode.ESTOPPED) == UNCONFIRMED


@pytest.mark.parametrize(
    ("power", "words"),
    [
        (None, ""),
        (OFF, "confirmed off"),
        (FED, "18 fed"),
        (DOUBTED, "off not confirmed, 18 fed"),
        (DOUBTED.model_copy(update={"supplied": ()}), "off not confirmed"),
        (SILENT, "does not answer"),
    ],
)
def test_the_board_in_words(power: PowerReport | None, words: str) -> None:
    assert power_now(power) == words


def test_every_event_that_stops_all_legs_and_every_doubt_is_bad() -> None:
    for kind in (*(each for each in Kind if each.stops), Kind.POWER_UNCONFIRMED, Kind.SERVO_DRAWS):
        assert tone_of(kind) == ("plain" if kind is Kind.LEGS_STOPPED else "bad"), kind
    assert tone_of(Kind.SERVO_SILENT) == "warn"
    assert tone_of(Kind.POWER_RESTORED) == tone_of("of a later gateway") == "plain"


# ---- where people see it


def test_a_terminal_is_red_until_the_board_confirms_a_stop() -> None:
    stop = pressed()
    stop.confirm(STOPPED.model_copy(update={"confirmed": False}), None, 150 * MS)
    assert stop.remark(10 * SHOWN_NS) == (UNCONFIRMED, True, 0)
    stop.power.received_state(of(OFF, Mode.ESTOPPED), 200 * MS)
    remark = stop.remark(200 * MS)
    assert remark is not None
    assert not remark.is_bad


@pytest.mark.parametrize(
    ("confirmed", "confirmed_ms", "power", "code", "words"),
    [
        (None, None, None, 0, "of the request\n"),
        (True, 34.2, OFF, 0, "of the request, power confirmed off after 34 ms\n"),
        (False, None, DOUBTED, 1, f"of the request\n{UNCONFIRMED}\n"),
        (False, None, SILENT, 1, f"of the request\n{UNCONFIRMED}\n"),
        (False, None, UnansweredError("no state"), 1, f"of the request\n{UNCONFIRMED}\n"),
        (False, None, FED, 0, "of the request\n"),  # nothing is to be off: this Stop leaves the supply on
    ],
)
def test_the_command_says_whether_the_board_confirmed(
    capsys: pytest.CaptureFixture[str],
    confirmed: bool | None,
    confirmed_ms: float | None,
    power: PowerReport | UnansweredError | None,
    code: int,
    words: str,
) -> None:
    def look() -> GatewayState:
        if isinstance(power, UnansweredError):
            raise power
        return of(power, Mode.ESTOPPED)

    ack = STOPPED.model_copy(update={"confirmed": confirmed, "confirmed_ms": confirmed_ms})
    assert estop_report(ack, look) == code
    assert capsys.readouterr().out == f"stopped: 6 Stop frames written within 812 µs {words}"
    assert command_report(ack, "accepted of the request", look) == code
    assert capsys.readouterr().out == f"accepted {words}", "a Stop of single legs, too"
    assert confirmed_off(Ack(accepted=True, confirmed=True)) == ", power confirmed off"


async def test_a_page_gets_the_sentence_with_the_state_and_at_once_with_the_event() -> None:
    pages, page = Pages("", lambda: 0), OpenPage()
    pages.add(cast("Page", page))

    async def newest() -> dict[str, str]:
        text = [each for each in await page.outgoing.wait() if '"type":"state"' in each][-1]
        return dict(re.findall(r'"(power|unconfirmed)": "([^"]*)"', text))

    pages.received_state(of(FED), 0)
    assert await newest() == {"power": "18 fed", "unconfirmed": ""}
    pages.received_event(event(Kind.POWER_UNCONFIRMED))
    assert await newest() == {"power": "18 fed", "unconfirmed": UNCONFIRMED}
    pages.received_state(of(OFF), 1)
    assert await newest() == {"power": "confirmed off", "unconfirmed": ""}


def test_the_sentence_stands_in_one_place() -> None:
    """No surface decides for itself what is not confirmed."""
    people = Path(__file__).parents[3] / "gateway" / "people"
    files = [each for each in people.rglob("*") if each.suffix in (".py", ".js", ".html")]
    assert [each.name for each in files if UNCONFIRMED in each.read_text()] == ["dangers.py"]


AnyPress = Press[str, str]
AnyRequest = StopRequest[str]


class Stop(ConfirmedStop[str, str]):
    """By one page, unless another is named."""

    def presses(self, press_id: int, now_ns: int = 0, page: str = "page") -> AnyPress:
        return self.press(page, press_id, f"by {page}", now_ns)

    def begins(self, now_ns: int = 0) -> AnyRequest:
        request = self.begin(now_ns)
        assert request is not None
        return request


def test_a_press_is_asked_for_at_once_and_confirmed_by_its_answer() -> None:
    stop = Stop()
    assert (stop.due_ns, stop.since_ns, stop.begin(5)) == (None, None, None)
    press = stop.presses(7, 5)
    assert (stop.due_ns, stop.since_ns) == (5, 5)
    request = stop.begins(5)
    assert request.what == "by page"
    assert (stop.begin(5), stop.due_ns, press.over) == (None, None, False)
    assert stop.ended(request, 6, answered=True) == [press]
    assert (press.over, press.attempts, stop.since_ns, stop.due_ns) == (True, 1, None, None)


def test_a_stop_that_lasts_is_requested_until_its_end_whatever_the_clock_shows() -> None:
    stop = Stop(lasts_ns=2 * AGAIN_NS)
    begun_ns = 10**12
    press = stop.presses(7, begun_ns)
    for attempt in (0, 1, 2):
        assert not press.over
        stop.ended(stop.begins(begun_ns + attempt * AGAIN_NS), begun_ns + attempt * AGAIN_NS, answered=False)
        assert stop.due_ns in (None, begun_ns + (attempt + 1) * AGAIN_NS)
    assert (press.over, press.attempts) == (True, 3)


def test_a_page_that_leans_on_it_keeps_its_newest_and_takes_nothing_from_others() -> None:
    stop = Stop()
    stop.presses(1, page="other")
    for number in range(10 * MAX_PRESSES):
        stop.presses(number)
    confirmed = stop.ended(stop.begins(), 1, answered=True)
    assert [press.id for press in confirmed] == [1, *range(9 * MAX_PRESSES, 10 * MAX_PRESSES)]


class AnyOrder(RuleBasedStateMachine):
    """What the caller knows: its presses in order, and its requests, each with how many presses came before it."""

    under_way = Bundle("under_way")
    pages = st.sampled_from(["anna", "bert", "clara"])

    def __init__(self) -> None:
        super().__init__()
        self.stop = ConfirmedStop[str, int]()
        self.now_ns = 0
        self.pressed: list[Press[str, int]] = []
        self.before: dict[StopRequest[int], int] = {}
        """How many presses there were when it began."""

    @rule(page=pages)
    def press(self, page: str) -> None:
        self.pressed.append(self.stop.press(page, len(self.pressed), len(self.pressed), self.now_ns))

    @rule(page=pages, count=st.sampled_from([2, MAX_PRESSES + 1]))
    def lean(self, page: str, count: int) -> None:
        for _ in range(count):
            self.press(page)

    @rule(target=under_way)
    @precondition(lambda self: self.stop.due_ns is not None and self.stop.due_ns <= self.now_ns)
    def begin(self) -> StopRequest[int]:
        request = self.stop.begin(self.now_ns)
        assert request is not None, "it was due"
        assert request.what == self.pressed[-1].id
        self.before[request] = len(self.pressed)
        return request

    @rule(request=consumes(under_way), answered=st.booleans())
    def end(self, request: StopRequest[int], answered: bool) -> None:
        before = self.before.pop(request)
        waited = self.stop.ended(request, self.now_ns, answered=answered)
        assert all(press.number <= before for press in waited), "an answer counts only for a press before its request"
        assert all(press.over is answered for press in waited)
        assert len(waited) <= 3 * MAX_PRESSES + 1, "three pages, and one press for all that have gone"

    @rule(page=pages)
    def leave(self, page: str) -> None:
        self.stop.leave(page)

    @rule()
    def take_back(self) -> None:
        self.stop.take_back()
        for press in self.pressed:
            press.over = True
        assert self.stop.since_ns is None

    @rule(by_ns=st.sampled_from([1, AGAIN_NS // 2, AGAIN_NS]))
    def wait(self, by_ns: int) -> None:
        self.now_ns += by_ns

    @invariant()
    def each_press_waits_for_a_request_that_can_confirm_it(self) -> None:
        if not self.pressed or self.pressed[-1].over:
            return
        assert self.stop.since_ns is not None, "the newest press is never given up"
        confirms = any(before == len(self.pressed) for before in self.before.values())
        due_ns = self.stop.due_ns
        assert (
            confirms
            or len(self.before) == REQUESTS_AT_ONCE
            or (due_ns is not None and due_ns <= self.now_ns + AGAIN_NS)
        )

    @invariant()
    def bounded(self) -> None:
        assert len(self.before) <= REQUESTS_AT_ONCE

    def teardown(self) -> None:
        """Check that every press is confirmed once the gateway answers, whatever came before."""
        for request in list(self.before):
            self.end(request, answered=False)
        if self.stop.since_ns is not None:
            self.now_ns += AGAIN_NS
            self.end(self.begin(), answered=True)
        assert self.stop.since_ns is None
        assert not self.pressed or self.pressed[-1].over


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(stateful_step_count=40)
