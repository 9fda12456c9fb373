"""The inbox part by part: depths, order, channels, threads, wakeups. A session's own messages take the same rings."""

import asyncio
import itertools
import queue
import threading
import time
from collections import defaultdict
from collections.abc import AsyncIterator, Callable
from contextlib import closing
from functools import partial
from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from gateway.host.settings_table import ZenohSettings
from gateway.robot.core.message import Received, Verb
from gateway.robot.host.ownership import Ownership
from gateway.robot.zenoh_io.inbox import OTHER_DEPTH, POLL_AFTER_FLOOD, Inbox
from gateway.robot.zenoh_io.questions import POLL_AGAIN_S
from gateway.robot.zenoh_io.rings import LEAST_PUT_DEPTH, RING_DEPTH
from gateway.robot.zenoh_io.session import service_config
from gateway.zenoh.config import open_session
from schemas.keys import ALL_COMMANDS, ESTOP, LEASE, leg_command, servo_command
from tests.support.gateway_process import free_port
from tests.support.interleaved import Sample
from tests.support.waiting import wait_until

LEG_1 = leg_command(1)
PATIENCE_S = 20.0


class Held:
    """An inbox. `takes`: it takes all that there is whenever it rings; else what a tick would take is looked at."""

    def __init__(self, opened: zenoh.Session, *, takes: bool = False) -> None:
        self.woken = threading.Event()
        self.taken: list[str] = []
        self.estops: list[Received] = []
        self.estop_received_by: queue.Queue[str] = queue.Queue()
        """The thread of each, by its name."""
        self.owner = Ownership()
        self.inbox = Inbox(
            opened,
            asyncio.get_running_loop(),
            self.owner,
            on_wakeup=self.tick if takes else self.woken.set,
            on_estop=self._stop,
            readers={LEASE: lambda _query, _ns, reply: partial(reply, b"read")},
            tokens={},
            on_estop_received=lambda: self.estop_received_by.put(threading.current_thread().name),
        )

    def tick(self) -> None:
        """Tick as owner, on any thread."""
        self.taken += [received.key for received in self.inbox.take()]

    def _stop(self) -> None:
        while self.inbox.estops:
            self.estops.append(self.inbox.estops.popleft())

    async def until(self, condition: Callable[[], bool]) -> None:
        """Wait for what a receiver thread does beside the loop."""
        await asyncio.to_thread(wait_until, condition)

    async def close(self) -> None:
        await asyncio.to_thread(self.inbox.close)


@pytest.fixture
async def session() -> AsyncIterator[zenoh.Session]:
    with closing(open_session(service_config(ZenohSettings(listen=(f"tcp/127.0.0.1:{free_port()}",))))) as opened:
        yield opened


@pytest.fixture
async def held(session: zenoh.Session) -> AsyncIterator[Held]:
    made = Held(session)
    yield made
    await made.close()


async def test_a_message_without_a_wakeup_is_taken_within_a_beat(session: zenoh.Session) -> None:
    """Else a start would wait for another message, perhaps for minutes, and then move the robot."""

    def subscribe(key: str, ring: Any) -> Any:
        if key == ALL_COMMANDS:
            session.put(LEG_1, b"{}")
        return session.declare_subscriber(key, ring)

    early: Any = SimpleNamespace(declare_subscriber=subscribe, declare_queryable=session.declare_queryable)
    held = Held(early, takes=True)
    held.inbox.makes_progress()
    await held.until(lambda: held.taken == [LEG_1])
    await held.close()


# ---- the emergency stop


async def test_an_emergency_stop_comes_before_what_was_taken_earlier(session: zenoh.Session, held: Held) -> None:
    for _ in range(4):
        session.put(LEG_1, b"{}")
    await held.until(held.woken.is_set)
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


@pytest.mark.parametrize("ask", [False, True], ids=["put", "get"])
async def test_the_second_way_to_stop_never_waits_for_the_state(session: zenoh.Session, held: Held, ask: bool) -> None:
    """A transfer that hangs holds the state; the thread that receives the message calls before it waits for it."""
    with held.owner:
        asked = session.get(ESTOP, timeout=PATIENCE_S) if ask else session.put(ESTOP, b"")
        name = await asyncio.to_thread(held.estop_received_by.get, timeout=PATIENCE_S)
        assert "estop-" + ("get" if ask else "put") in name
        assert not held.estops, "the first way waits"
    await held.until(lambda: len(held.estops) == 1)
    del asked


async def test_an_emergency_stops_answer_waits_for_no_other_answer(session: zenoh.Session, held: Held) -> None:
    """The sender of all other answers waits for an asker who does not read."""
    gate = threading.Event()
    held.inbox._replies.do(partial(gate.wait, 2 * PATIENCE_S))
    asked = session.get(ESTOP, timeout=PATIENCE_S)
    await held.until(lambda: bool(held.estops))
    (each,) = held.estops
    assert each.reply is not None
    each.reply(b"stopped")
    reply = await asyncio.to_thread(lambda: next(iter(asked)))
    gate.set()
    assert reply.ok is not None
    assert reply.ok.payload.to_bytes() == b"stopped"


# ---- threads


ENDS: list[Callable[[Inbox], None]] = [
    *(lambda inbox, place=place: inbox._declared[place].undeclare() for place in (-5, -4, -3, -2)),
    lambda inbox: inbox._asked[LEASE].close(),
    lambda inbox: inbox._replies.close(),
    lambda inbox: inbox._estop_replies.close(),
    lambda inbox: inbox._endings.close(),
]


def threads_of(inbox: Inbox) -> list[threading.Thread]:
    return [each.thread for each in inbox._receivers] + [each.thread for each in inbox._workers]


@pytest.mark.parametrize("end", ENDS)
async def test_each_thread_of_the_inbox_that_ends_is_noticed(held: Held, end: Callable[[Inbox], None]) -> None:
    assert held.inbox.makes_progress()
    end(held.inbox)
    await held.until(lambda: not held.inbox.makes_progress())
    await held.close()
    assert not any(thread.is_alive() for thread in threads_of(held.inbox))


# ---- wakeups


async def test_an_instant_that_a_flood_left_open_is_closed(held: Held, monkeypatch: pytest.MonkeyPatch) -> None:
    rings = SimpleNamespace(read=lambda _keys: [], instant_open=True, passed_over=0)
    monkeypatch.setattr(held.inbox, "_rings", rings)
    assert list(held.inbox.take()) == []
    await held.until(held.woken.is_set)


# ---- no message stays in its ring because its wakeup was lost, or because the state was owned meanwhile


async def test_a_message_whose_wakeup_was_lost_while_the_state_was_owned_is_taken(session: zenoh.Session) -> None:
    """A leg's, among those of a servo of another one: for that servo nobody would look into the leg's ring."""
    taker = Held(session, takes=True)
    with taker.owner:  # the thread that hears of the first waits with it
        for key in (servo_command(63), leg_command(1), *[servo_command(61)] * (OTHER_DEPTH + 2)):
            session.put(key, b"{}")
    await taker.until(lambda: leg_command(1) in taker.taken)
    await taker.close()


class LateRing:
    """A subscriber and its ring in one, whose messages come when the test says so."""

    def __init__(self) -> None:
        self.handler = self
        self._items: SimpleQueue[Sample | None] = SimpleQueue()

    def put(self, item: Sample | None) -> None:
        self._items.put(item)

    def recv(self) -> Sample:
        item = self._items.get()
        if item is None:
            raise zenoh.ZError("closed")
        return item

    def try_recv(self) -> Sample | None:
        return None if self._items.empty() else self._items.get()

    def undeclare(self) -> None:
        self.put(None)


# ---- wakeups and messages of a key: W, a wakeup arrives; M, a message reaches its ring; T, a tick

K, OTHER, FURTHER = leg_command(1), leg_command(2), leg_command(3)


class Counted(Held):
    """An inbox whose wakeups and messages come when the test says so; each step is taken at once."""

    def __init__(self) -> None:
        self.rings: defaultdict[str, LateRing] = defaultdict(LateRing)
        late: Any = SimpleNamespace(
            declare_subscriber=lambda key, _: self.rings[key], declare_queryable=lambda _key, _: LateRing()
        )
        super().__init__(late, takes=True)
        self.inbox: Any

    def step(self, kind: str, key: str = K) -> None:
        with self.owner:
            if kind == "M":
                self.rings[key].put(Sample(key))
            elif kind == "T":
                self.tick()
            else:
                self.inbox._on_wakeup(Sample(key), 0)


@pytest.fixture
async def counted() -> AsyncIterator[Counted]:
    made = Counted()
    yield made
    await made.close()


async def test_a_message_that_reaches_its_ring_after_its_wakeup_is_taken(counted: Counted) -> None:
    counted.step("W")
    counted.step("M")
    await counted.until(lambda: counted.taken == [K])


async def test_whatever_the_order_all_are_looked_for_that_may_be_missed(counted: Counted) -> None:
    """In every order of six: a wakeup without its message has all rings read again until the ladder's end."""
    for steps in itertools.product("WMT", repeat=6):
        for step in steps:
            counted.inbox._attempt = len(POLL_AGAIN_S)
            before = len(counted.taken)
            counted.step(step)
            missed = step == "W" and len(counted.taken) == before
            assert (counted.inbox._attempt == 0) is missed, steps
        counted.step("T")
        assert len(counted.taken) == steps.count("M"), steps
        counted.taken.clear()


@pytest.mark.parametrize(
    ("waiting", "all_rings"), [(OTHER_DEPTH - 3, False), (OTHER_DEPTH - 2, True), (OTHER_DEPTH + 3, True)]
)
async def test_a_wakeup_that_may_have_lost_some_reads_all_rings(
    counted: Counted, waiting: int, all_rings: bool
) -> None:
    """They include the messages missed before. All rings are polled once more, after the flood's next tick."""
    counted.step("W", FURTHER)
    counted.rings[OTHER].put(Sample(OTHER))
    wakeups = [Sample(K)] * waiting
    counted.inbox._wakeups = (SimpleNamespace(try_recv=lambda: wakeups.pop() if wakeups else None),)
    counted.step("W")
    assert len(wakeups) == max(0, waiting - OTHER_DEPTH), "what comes meanwhile is left for the next time"
    assert counted.taken == [OTHER] * all_rings
    assert counted.inbox._attempt == (POLL_AFTER_FLOOD if all_rings else 0)
    assert not counted.inbox._read_all, "at the next tick those that were heard of are read"
    counted.step("M", FURTHER)
    counted.inbox._poll_now()
    assert FURTHER in counted.taken


async def test_a_full_ring_counts_what_it_passed_over_and_an_unknown_key_has_no_target(
    counted: Counted,
) -> None:
    for _ in range(LEAST_PUT_DEPTH):
        counted.rings[K].put(Sample(K))
    begun_ns = time.monotonic_ns()
    with counted.owner:
        lost, *newest = counted.inbox.take()
    assert (lost.verb, lost.size) == (Verb.LOST, LEAST_PUT_DEPTH - RING_DEPTH)
    assert [each.verb for each in newest] == [Verb.PUT] * RING_DEPTH
    assert begun_ns <= newest[0].received_ns <= time.monotonic_ns()
    assert newest[0].size == 0
    with counted.owner:
        counted.inbox._note(Sample("hexapod/x/cmd"), 7)
        (unknown,) = counted.inbox.take()
    assert (unknown.target, unknown.received_ns) == (None, 7)


async def test_the_inbox_is_closed_once_no_thread_has_anything_in_hand() -> None:
    counted = Counted()
    assert counted.inbox.makes_progress()
    closing = threading.Thread(target=counted.inbox.close)
    with counted.owner:
        counted.rings[ESTOP].put(Sample(ESTOP))  # its thread waits for the state
        closing.start()
        closing.join(0.1)
        assert closing.is_alive()
    closing.join(PATIENCE_S)
    assert not any(thread.is_alive() for thread in threads_of(counted.inbox))
    assert [each.key for each in counted.estops] == [ESTOP]
