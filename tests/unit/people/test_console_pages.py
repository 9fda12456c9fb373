"""What waits for one page is bounded, of the state only the newest is sent, and STOP ALL is asked until confirmed."""

import asyncio
import json
from collections.abc import AsyncIterator
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest

from gateway.errors import DisconnectedError
from gateway.people.console.pages.page_messages import Message, ack_message, event_message, link_message
from gateway.people.console.pages.page_tasks import KEPT_MESSAGES, EndError, Outgoing, PageTasks, Stops, send_stopping
from gateway.people.console.pages.pages import Page, Pages
from gateway.people.watching.confirmed_stop import AGAIN_NS
from schemas.ack import Ack
from schemas.config import WireReport
from schemas.telemetry import Telemetry
from schemas.words import Kind
from tests.support.published import WALL, event, state

pytestmark = pytest.mark.virtual_time


def stopping(number: int, *, answered: bool) -> Message:
    return {"type": "stop", "id": number, "answered": answered}


async def sent(outgoing: Outgoing) -> list[dict[str, Any]]:
    return [json.loads(text) for text in await outgoing.wait()]


async def test_a_page_that_reads_nothing_costs_a_bounded_amount() -> None:
    outgoing = Outgoing()
    for number in range(1000):
        outgoing.put(event_message(event(Kind.STARTED, str(number))))
        outgoing.put(ack_message(number))
        outgoing.put(link_message("gone", str(number)))
        outgoing.put(stopping(number % 3, answered=number >= 999))
        outgoing.put_state(partial(json.dumps, {"type": "state", "number": number}))
    messages = await sent(outgoing)
    assert len(messages) == 3 + KEPT_MESSAGES + 1 + 1 + KEPT_MESSAGES
    assert [message["number"] for message in messages if message["type"] == "state"] == [999]
    assert [message["detail"] for message in messages if message["type"] == "link"] == ["999"]
    events = [message for message in messages if message["type"] == "event"]
    assert [message["event"]["detail"] for message in events] == [
        str(number) for number in range(1000 - KEPT_MESSAGES, 1000)
    ]
    assert [message["left_out"] for message in events] == [1000 - KEPT_MESSAGES, *[0] * (KEPT_MESSAGES - 1)]


async def test_the_stop_goes_first() -> None:
    outgoing = Outgoing()
    outgoing.put_state(lambda: '{"type": "state"}')
    outgoing.put(event_message(event(Kind.STARTED)))
    outgoing.put(ack_message(1))
    outgoing.put(stopping(7, answered=False))
    outgoing.put(stopping(7, answered=True))
    messages = await sent(outgoing)
    assert [message["type"] for message in messages] == ["stop", "ack", "state", "event"]
    assert messages[0]["answered"]


# ---- what it may have under way


@pytest.mark.parametrize(("in_turn", "began"), [(True, [1, 1, 2, 2, 3, 3]), (False, [1, 2, 3, 1, 2, 3])])
async def test_a_page_has_so_many_tasks_and_its_end_one_more(in_turn: bool, began: list[int]) -> None:
    """What a page's end requires is never rejected: it releases the lease."""
    tasks, steps = PageTasks(2, "commands", in_turn=in_turn), list[int]()

    async def work(number: int) -> None:
        steps.append(number)
        await asyncio.sleep(0)
        steps.append(number)

    for number in (1, 2):
        tasks.check()
        tasks.start(work(number))
    with pytest.raises(EndError, match="2 commands of this page wait for their answers"):
        tasks.check()
    tasks.start(work(3))
    await tasks.ended(1)
    assert steps == began
    tasks.check()


# ---- of a robot that measures


SECOND_NS = 1_000_000_000


class Kept(Outgoing):
    """Keeps all that is put in."""

    def __init__(self) -> None:
        super().__init__()
        self.put_in: list[Message] = []

    def put(self, message: Message) -> None:
        self.put_in.append(message)
        super().put(message)


class OpenPage:
    """As much of a page as `Pages` uses."""

    def __init__(self) -> None:
        self.outgoing = Kept()

    def allow_age(self, max_age_ms: float) -> None:
        """It sends nothing."""


def measured(tilt_deg: float) -> Telemetry:
    return Telemetry(time=WALL, age_ms=1.0, tilt_deg=tilt_deg)


def opened(now: SimpleNamespace) -> tuple[Pages, Kept]:
    pages, page = Pages("", lambda: 0, lambda: now.ns), OpenPage()
    pages.add(cast("Page", page))
    page.outgoing.put_in.clear()
    return pages, page.outgoing


@pytest.mark.parametrize("rate_hz", [5, 10, 100])
async def test_telemetry_reaches_a_page_ten_times_in_any_second_at_most_and_the_newest_alone_waits(
    rate_hz: int,
) -> None:
    pages, outgoing = opened(now := SimpleNamespace(ns=0))
    sent_ns = []
    for number in range(20 * rate_hz):
        now.ns = number * SECOND_NS // rate_hz
        before = len(outgoing.put_in)
        pages.received_telemetry(measured(number))
        sent_ns += [now.ns] * (len(outgoing.put_in) - before)
    most = max(sum(at <= each < at + SECOND_NS for each in sent_ns) for at in sent_ns)
    assert most <= 10
    assert len(sent_ns) >= 20 * min(rate_hz, 8), "and no page waits for more than an eighth of a second"
    (newest,) = [each for each in await sent(outgoing) if each["type"] == "telemetry"]  # of those nobody has read
    assert newest["telemetry"].keys() == {"time", "age_ms", "tilt_deg"}, "what is not measured is left out"


@pytest.mark.parametrize("whole", [False, True])
async def test_a_state_tells_a_page_whether_only_the_whole_robot_starts(*, whole: bool) -> None:
    pages, outgoing = opened(SimpleNamespace(ns=0))
    report = state().model_copy(update={"wire": WireReport(whole_robot=whole)})
    pages.received_state(report, 0)
    messages: list[dict[str, Any]] = [json.loads(text) for text in await outgoing.wait()]
    assert [each["whole"] for each in messages if each["type"] == "state"] == [whole]


# ---- STOP ALL: confirmed by an answer to a request that began after the press


AGAIN_S = AGAIN_NS / 1e9
ACK = Ack(accepted=True, stop_frames=6, estop=1, latency_us=900.0)


class StoppedRobot:
    """Answers when the test says so."""

    def __init__(self) -> None:
        self.requests: list[asyncio.Future[Ack]] = []

    async def estop(self, _source: str) -> Ack:
        request: asyncio.Future[Ack] = asyncio.get_running_loop().create_future()
        self.requests.append(request)
        return await request


def heard(page: Kept) -> list[Message]:
    """Return all progress messages about its stops."""
    return [message for message in page.put_in if message["type"] == "stop"]


async def turns() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


@pytest.fixture
async def robot() -> AsyncIterator[StoppedRobot]:
    found = StoppedRobot()
    yield found
    for request in found.requests:
        if not request.done():
            request.set_result(ACK)
    await turns()


@pytest.mark.parametrize("leaves", [False, True])
async def test_a_press_is_asked_at_once_and_again_until_it_is_answered_and_outlives_its_page(
    robot: StoppedRobot, leaves: bool
) -> None:
    stops, page = Stops(robot.estop, send_stopping), Kept()
    stops.press(page, 7, "anna (page 1)")
    assert [(message["answered"], message["attempts"]) for message in heard(page)] == [(False, 0)]
    if leaves:
        stops.leave(page)
    for number in range(5):
        await turns()
        assert len(robot.requests) == number + 1
        robot.requests[number].set_exception(DisconnectedError("no answer"))
        await turns()
        newest = heard(page)[-1]
        assert leaves or (newest["attempts"], newest["error"]) == (number + 1, "no answer")
        assert stops.unconfirmed
        await asyncio.sleep(AGAIN_S)
    await turns()
    robot.requests[5].set_result(ACK)
    await turns()
    confirmed = [(each["id"], each["stop_frames"], each["attempts"]) for each in heard(page) if each["answered"]]
    assert confirmed == ([] if leaves else [(7, 6, 6)])
    assert (len(robot.requests), stops.unconfirmed) == (6, False), "nobody waits any more"
