"""STOP ALL: asked until it is confirmed, by an answer to a request that began after the press."""

import asyncio
from collections.abc import AsyncIterator

import pytest

from gateway.errors import DisconnectedError
from gateway.people.client.confirmed_stop import AGAIN_NS
from gateway.people.console.pages.page_messages import Stopping
from gateway.people.console.pages.page_tasks import Outgoing, Stops, send_stopping
from schemas.telemetry import Ack, Report

pytestmark = pytest.mark.virtual_time

AGAIN_S = AGAIN_NS / 1e9
ACK = Ack(accepted=True, stop_frames=6, estop=1, latency_us=900.0)


class Robot:
    """Answers when the test says so."""

    def __init__(self) -> None:
        self.requests: list[asyncio.Future[Ack]] = []
        self.sources: list[str] = []

    async def estop(self, source: str) -> Ack:
        self.sources.append(source)
        request: asyncio.Future[Ack] = asyncio.get_running_loop().create_future()
        self.requests.append(request)
        return await request

    async def answer(self, number: int, ack: Ack = ACK) -> None:
        self.requests[number].set_result(ack)
        await turns()

    async def fail(self, number: int) -> None:
        self.requests[number].set_exception(DisconnectedError("no answer"))
        await turns()


class Page(Outgoing):
    """Keeps all that it is sent of how far its stops have come."""

    def __init__(self) -> None:
        super().__init__()
        self.heard: list[Stopping] = []

    def put(self, message: Report) -> None:
        assert isinstance(message, Stopping)
        self.heard.append(message)

    def answered(self) -> list[int]:
        return [message.id for message in self.heard if message.answered]


async def turns() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


@pytest.fixture
async def robot() -> AsyncIterator[Robot]:
    found = Robot()
    yield found
    for request in found.requests:
        if not request.done():
            request.set_result(ACK)
    await turns()


async def test_a_press_is_asked_at_once_and_again_until_it_is_answered(robot: Robot) -> None:
    stops, page = Stops(robot.estop, send_stopping), Page()
    stops.press(page, 7, "anna (page 1)")
    assert [(message.answered, message.attempts) for message in page.heard] == [(False, 0)]
    for number in range(5):
        await turns()
        assert len(robot.requests) == number + 1
        await robot.fail(number)
        newest = page.heard[-1]
        assert (newest.answered, newest.attempts, newest.error) == (False, number + 1, "no answer")
        assert stops.unconfirmed
        await asyncio.sleep(AGAIN_S)
    await turns()
    await robot.answer(5)
    assert (page.answered(), page.heard[-1].stop_frames, page.heard[-1].attempts) == ([7], 6, 6)
    assert (len(robot.requests), stops.unconfirmed) == (6, False), "nobody waits any more"


async def test_a_press_outlives_its_page(robot: Robot) -> None:
    stops, page = Stops(robot.estop, send_stopping), Page()
    stops.press(page, 1, "anna (page 1)")
    stops.leave(page)
    await turns()
    await robot.fail(0)
    assert stops.unconfirmed
    await asyncio.sleep(AGAIN_S)
    await turns()
    await robot.answer(1)
    assert not stops.unconfirmed
    assert page.answered() == []
