"""A Stop that is pressed until it is confirmed, in virtual time: presses, answers and failures in any order."""

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, consumes, invariant, precondition, rule

from gateway.people.watching.confirmed_stop import (
    AGAIN_NS,
    MAX_PRESSES,
    REQUESTS_AT_ONCE,
    ConfirmedStop,
    Press,
    StopRequest,
)

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


def ids(presses: list[AnyPress]) -> list[int | None]:
    return [press.id for press in presses]


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


def test_one_that_lasts_is_asked_for_until_then_whatever_the_clock_shows() -> None:
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
    assert ids(confirmed) == [1, *range(9 * MAX_PRESSES, 10 * MAX_PRESSES)]


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
        """Whatever came before: once the gateway answers, every press is confirmed."""
        for request in list(self.before):
            self.end(request, answered=False)
        if self.stop.since_ns is not None:
            self.now_ns += AGAIN_NS
            self.end(self.begin(), answered=True)
        assert self.stop.since_ns is None
        assert not self.pressed or self.pressed[-1].over


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(stateful_step_count=40)
