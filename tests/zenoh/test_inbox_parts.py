"""The inbox part by part: depths, order, channels, threads. A session's own messages take the same rings."""

import asyncio
import queue
import threading
import time
from collections.abc import AsyncIterator, Callable
from functools import partial
from types import SimpleNamespace

import pytest
import zenoh

from gateway.robot.core.message import Received
from gateway.robot.host.ownership import Ownership
from gateway.robot.zenoh_io.inbox import Inbox
from schemas.keys import ESTOP, LEASE, leg_command

LEG_1 = leg_command(1)
PATIENCE_S = 20.0


class Held:
    """An inbox. `takes`: it takes all that there is whenever it rings; else what a tick would take is looked at."""

    def __init__(self, opened: zenoh.Session, *, takes: bool = False) -> None:
        self.wakeups = asyncio.Event()
        self.taken: list[str] = []
        self.estops: list[Received] = []
        self.estop_received_by: queue.Queue[str] = queue.Queue()
        """The thread of each, by its name."""
        self._loop = asyncio.get_running_loop()
        self.owner = Ownership()
        self.inbox = Inbox(
            opened,
            self._loop,
            self.owner,
            on_wakeup=self.tick if takes else self.wake,
            on_estop=self._stop,
            readers={LEASE: lambda _query, _ns, reply: partial(reply, b"read")},
            tokens={},
            on_estop_received=lambda: self.estop_received_by.put(threading.current_thread().name),
        )

    def tick(self) -> None:
        """As owner, on any thread."""
        self.taken += [received.key for received in self.inbox.take()]
        self.wake()

    def wake(self) -> None:
        self._loop.call_soon_threadsafe(self.wakeups.set)

    def _stop(self) -> None:
        while self.inbox.estops:
            self.estops.append(self.inbox.estops.popleft())
        self.wake()

    async def woken(self) -> None:
        async with asyncio.timeout(PATIENCE_S):
            await self.wakeups.wait()
        self.wakeups.clear()

    async def until(self, condition: Callable[[], bool]) -> None:
        """For what a receiver thread does beside the loop."""
        ends_s = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < ends_s
            await asyncio.to_thread(time.sleep, 0.001)

    async def close(self) -> None:
        await asyncio.to_thread(self.inbox.close)


@pytest.fixture
async def held(session: zenoh.Session) -> AsyncIterator[Held]:
    made = Held(session)
    yield made
    await made.close()


# ---- the emergency stop


async def test_an_emergency_stop_comes_before_all_that_was_taken_and_not_yet_dealt_with(
    session: zenoh.Session, held: Held
) -> None:
    for _ in range(4):
        session.put(LEG_1, b"{}")
    await held.woken()
    with held.owner:
        taking = iter(held.inbox.take())
        assert next(taking).key == LEG_1
        session.put(ESTOP, b"")
        await held.until(lambda: bool(held.inbox.estops))
        assert [each.key for each in held.inbox.estops] == [ESTOP], "before the others are dealt with"
        held.inbox.estops.clear()
        assert [each.key for each in taking] == [LEG_1, LEG_1, LEG_1]
    session.put(ESTOP, b"again")
    await held.until(lambda: bool(held.estops))
    assert [each.payload for each in held.estops] == [b"again"], "the other was taken, and once is enough"


async def test_an_emergency_stop_that_waits_for_the_state_is_taken_without_any_command(
    session: zenoh.Session, held: Held
) -> None:
    with held.owner:
        session.put(ESTOP, b"")
        await held.until(lambda: bool(held.inbox.estops))
        assert [each.key for each in held.inbox.take()] == []
        assert held.inbox.estops.popleft().key == ESTOP
    assert not held.estops


@pytest.mark.parametrize("ask", [False, True], ids=["put", "get"])
async def test_the_second_way_to_stop_does_not_wait_for_the_state(
    session: zenoh.Session, held: Held, ask: bool
) -> None:
    """A transfer that hangs holds the state; the thread that receives the message calls before it waits for it."""
    with held.owner:
        asked = session.get(ESTOP, timeout=PATIENCE_S) if ask else session.put(ESTOP, b"")
        name = await asyncio.to_thread(held.estop_received_by.get, timeout=PATIENCE_S)
        assert "estop-" + ("get" if ask else "put") in name
        assert not held.estops, "the first way waits"
    await held.until(lambda: len(held.estops) == 1)
    del asked


async def test_its_answer_waits_for_nobody_elses(session: zenoh.Session, held: Held) -> None:
    """The sender of all other answers waits for an asker who does not read."""
    gate = threading.Event()

    waited: list[bool] = []

    def hold_up() -> None:
        waited.append(gate.wait(PATIENCE_S))

    held.inbox._replies.do(hold_up)
    asked = session.get(ESTOP, timeout=PATIENCE_S)
    await held.until(lambda: bool(held.estops))
    (each,) = held.estops
    assert each.reply is not None
    each.reply(b"stopped")
    reply = await asyncio.to_thread(lambda: next(iter(asked)))
    assert not waited
    gate.set()
    assert reply.ok is not None
    assert reply.ok.payload.to_bytes() == b"stopped"


# ---- threads


ENDS: list[Callable[[Inbox], None]] = [
    *(lambda inbox, place=place: inbox._declared[place].undeclare() for place in (-5, -4, -3, -2)),
    lambda inbox: inbox._asked[LEASE].close(),
    lambda inbox: inbox._replies.close(),
    lambda inbox: inbox._estop_replies.close(),
]


@pytest.mark.parametrize("end", ENDS)
async def test_each_of_its_threads_that_ends_is_noticed(held: Held, end: Callable[[Inbox], None]) -> None:
    assert held.inbox.receives
    alive = [thread for thread in held.inbox._threads if thread.is_alive()]
    end(held.inbox)
    await held.until(lambda: not all(thread.is_alive() for thread in alive))
    assert not held.inbox.receives
    await held.close()
    assert not any(thread.is_alive() for thread in held.inbox._threads)


async def test_a_mistake_is_told_to_the_loop_and_does_not_end_the_hearing(session: zenoh.Session, held: Held) -> None:
    loop, mistakes = asyncio.get_running_loop(), []
    loop.set_exception_handler(lambda _, context: mistakes.append(context))

    def fail() -> None:
        raise KeyError("a mistake of our own")

    held.inbox._wake = fail
    session.put(LEG_1, b"{}")
    await held.until(lambda: bool(mistakes))
    held.inbox._wake = held.wake
    session.put(LEG_1, b"{}")
    await held.woken()
    assert len(mistakes) == 1


# ---- wakeups


async def test_an_instant_that_a_flood_left_open_is_closed_though_nothing_else_comes(
    held: Held, monkeypatch: pytest.MonkeyPatch
) -> None:
    rings = SimpleNamespace(read=lambda _keys: [], instant_open=True)
    monkeypatch.setattr(held.inbox, "_rings", rings)
    assert list(held.inbox.take()) == []
    await held.woken()
