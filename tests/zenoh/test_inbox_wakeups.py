"""Wakeups: no message stays in its ring because its wakeup was lost, or because the state was owned meanwhile.

In one process: a session's own messages take the same rings.
"""

import asyncio
import itertools
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any

import pytest
import zenoh

from gateway.robot.core.message import Received, Reply
from gateway.robot.edge.inbox import OTHER_DEPTH, Inbox
from gateway.robot.host.ownership import Ownership
from schemas.keys import ALL_COMMANDS, COMMAND_KEYS, ESTOP, leg_command, servo_command

KEYS = [key for key in COMMAND_KEYS if key != ESTOP]
PATIENCE_S = 5.0


class Taker:
    """Takes whatever the inbox has, whenever it rings."""

    def __init__(self, session: zenoh.Session) -> None:
        self.taken: list[str] = []
        self.ticks = 0
        self._changed = asyncio.Event()
        self._loop = asyncio.get_running_loop()
        self.owner = Ownership()
        with self.owner:
            self.inbox = Inbox(
                session,
                self._loop,
                self.owner,
                on_wakeup=self.tick,
                on_estop=self._stop,
                on_state_query=self._answer,
            )

    def tick(self) -> None:
        """As owner, on any thread."""
        self.ticks += 1
        self.taken += [received.key for received in self.inbox.take()]
        self._loop.call_soon_threadsafe(self._changed.set)

    def _stop(self, received: Received) -> None:
        self.taken.append(received.key)

    def _answer(self, reply: Reply) -> None:
        reply(b"{}")

    async def wait_until(self, condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while not condition():
                self._changed.clear()
                await self._changed.wait()

    async def wait_for(self, *wanted: str) -> None:
        """Until all these keys have been taken; forgets them."""
        await self.wait_until(lambda: set(wanted) <= set(self.taken))
        self.taken.clear()


@pytest.fixture
async def taker(session: zenoh.Session) -> AsyncIterator[Taker]:
    taker = Taker(session)
    yield taker
    await asyncio.to_thread(taker.inbox.close)


async def test_more_messages_than_a_bell_holds_are_all_taken(session: zenoh.Session, taker: Taker) -> None:
    """More keys than the wakeup's ring is deep, while the loop is held: the first wakeups are lost."""
    for first in range(40):
        order = KEYS[first % len(KEYS) :] + KEYS[: first % len(KEYS)]
        for key in order:
            session.put(key, b"{}")
        await taker.wait_for(*KEYS)


async def test_a_message_whose_wakeup_was_lost_while_the_state_was_owned_is_taken(
    session: zenoh.Session, taker: Taker
) -> None:
    """A leg's, among those of a servo of another one: for that servo nobody would look into the leg's ring."""
    with taker.owner:  # the thread that hears of the first waits with it
        for key in (servo_command(63), leg_command(1), *[servo_command(61)] * (OTHER_DEPTH + 2)):
            session.put(key, b"{}")
    await taker.wait_for(leg_command(1))


@pytest.mark.parametrize("count", range(OTHER_DEPTH - 4, OTHER_DEPTH + 8))
async def test_no_bell_that_the_thread_holds_is_lost(session: zenoh.Session, taker: Taker, count: int) -> None:
    """About as many as the wakeup is deep: some are with its thread, and some may have been lost before."""
    wanted = KEYS[:count]
    for _ in range(40):
        for key in wanted:
            session.put(key, b"{}")
        await taker.wait_for(*wanted)


async def test_one_message_takes_one_tick(session: zenoh.Session, taker: Taker) -> None:
    for number, key in enumerate(itertools.islice(itertools.cycle(KEYS), 60), start=1):
        session.put(key, b"{}")
        await taker.wait_for(key)
        assert taker.ticks <= 2 * number, "a second look is rare, and ends"


class LateRings:
    """A session whose messages reach a wakeup's ring and their key's when the test says so."""

    def __init__(self) -> None:
        self.rings: dict[str, LateRing] = {}

    def declare_subscriber(self, key: str, _: object) -> "LateRing":
        return self.rings.setdefault(key, LateRing())

    def declare_queryable(self, _key: str, _ring: object) -> "LateRing":
        return LateRing()


class LateRing:
    """A subscriber and its ring in one."""

    def __init__(self) -> None:
        self.handler = self
        self._items: SimpleQueue[Sample | None] = SimpleQueue()

    def put(self, item: "Sample | None") -> None:
        self._items.put(item)

    def recv(self) -> "Sample":
        item = self._items.get()
        if item is None:
            raise zenoh.ZError("closed")
        return item

    def try_recv(self) -> "Sample | None":
        return None if self._items.empty() else self._items.get()

    def undeclare(self) -> None:
        self.put(None)


@dataclass
class Sample:
    """As much of one as the inbox looks at."""

    key_expr: str
    payload: None = None
    encoding: None = None
    source_info: None = None
    kind = zenoh.SampleKind.PUT


@pytest.mark.parametrize("early", [0, 1])
@pytest.mark.parametrize("beside", [0, 1])
async def test_a_message_that_reaches_its_ring_after_its_wakeup_is_taken(early: int, beside: int) -> None:
    """Also when another of the same key is taken in its place, or was taken before its own wakeup was heard."""
    key, other = KEYS[3], KEYS[4]
    late: Any = LateRings()
    taker = Taker(late)
    wakeups = late.rings[ALL_COMMANDS]
    try:
        for _ in range(early):
            late.rings[key].put(Sample(key))
            with taker.owner:
                taker.tick()
        for _ in range(beside):
            late.rings[key].put(Sample(key))
        late.rings[other].put(Sample(other))
        # One of them is in the thread's hands while the first tick takes the others: here that of the other key.
        for each in (key, other, *[key] * (early + beside)):
            wakeups.put(Sample(each))
        await taker.wait_until(lambda: len(taker.taken) == early + beside + 1)
        late.rings[key].put(Sample(key))
        await taker.wait_until(lambda: len(taker.taken) == early + beside + 2)
    finally:
        await asyncio.to_thread(taker.inbox.close)
