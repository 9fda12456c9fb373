"""Wakeups: no message stays in its ring because its wakeup was lost, or because the state was owned meanwhile.

In one process: a session's own messages take the same rings.
"""

import threading
import time
from collections.abc import AsyncIterator
from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from gateway.robot.core.message import Verb
from gateway.robot.zenoh_io.inbox import OTHER_DEPTH, POLL_AFTER_FLOOD
from gateway.robot.zenoh_io.questions import POLL_AGAIN_S
from gateway.robot.zenoh_io.rings import LEAST_PUT_DEPTH, RING_DEPTH
from schemas.keys import ALL_COMMANDS, COMMAND_KEYS, ESTOP, leg_command, servo_command
from tests.support.interleaved import Sample
from tests.zenoh.test_inbox_parts import PATIENCE_S, Held

KEYS = [key for key in COMMAND_KEYS if key != ESTOP]


@pytest.fixture
async def taker(session: zenoh.Session) -> AsyncIterator[Held]:
    taker = Held(session, takes=True)
    yield taker
    await taker.close()


async def test_a_message_whose_wakeup_was_lost_while_the_state_was_owned_is_taken(
    session: zenoh.Session, taker: Held
) -> None:
    """A leg's, among those of a servo of another one: for that servo nobody would look into the leg's ring."""
    with taker.owner:  # the thread that hears of the first waits with it
        for key in (servo_command(63), leg_command(1), *[servo_command(61)] * (OTHER_DEPTH + 2)):
            session.put(key, b"{}")
    await taker.until(lambda: leg_command(1) in taker.taken)


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
        self.closed = False
        self._items: SimpleQueue[Sample | None] = SimpleQueue()

    def put(self, item: Sample | None) -> None:
        self._items.put(item)

    def recv(self) -> Sample:
        item = self._items.get()
        if item is None:
            raise zenoh.ZError("closed")
        return item

    def try_recv(self) -> Sample | None:
        if self.closed:
            raise zenoh.ZError("closed")
        return None if self._items.empty() else self._items.get()

    def undeclare(self) -> None:
        self.put(None)


@pytest.mark.parametrize("early", [0, 1])
@pytest.mark.parametrize("beside", [0, 1])
async def test_a_message_that_reaches_its_ring_after_its_wakeup_is_taken(early: int, beside: int) -> None:
    """Also when another of the same key is taken in its place, or was taken before its own wakeup was heard."""
    key, other = KEYS[3], KEYS[4]
    late: Any = LateRings()
    taker = Held(late, takes=True)
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
        await taker.until(lambda: len(taker.taken) == early + beside + 1)
        late.rings[key].put(Sample(key))
        await taker.until(lambda: len(taker.taken) == early + beside + 2)
    finally:
        await taker.close()


# ---- how many messages of a key are heard of and taken: W, its wakeup is heard; M, it reaches its ring; T, a tick

K, OTHER, FURTHER = leg_command(1), leg_command(2), leg_command(3)


class Counted:
    """An inbox whose wakeups and messages come when the test says so; each step is taken at once."""

    def __init__(self) -> None:
        rings: Any = LateRings()
        self.rings: dict[str, LateRing] = rings.rings
        self.taker = Held(rings, takes=True)
        self.inbox: Any = self.taker.inbox

    def step(self, kind: str, key: str = K) -> None:
        with self.taker.owner:
            if kind == "M":
                self.rings[key].put(Sample(key))
            elif kind == "T":
                self.taker.tick()
            else:
                self.inbox._on_wakeup(named(key), 0)

    @property
    def left(self) -> dict[str, int]:
        """Those of which a wakeup was heard and that were not taken; negative: taken before their wakeup."""
        missed: dict[str, int] = self.inbox._missed
        return missed | {key: -count for key, count in self.inbox._early.items()}


def named(expression: str) -> Any:
    """As much of a sample as a wakeup looks at."""
    return SimpleNamespace(key_expr=zenoh.KeyExpr(expression) if "*" in expression else expression)


@pytest.fixture
async def counted() -> AsyncIterator[Counted]:
    made = Counted()
    yield made
    await made.taker.close()


@pytest.mark.parametrize(
    ("steps", "left"),
    [
        ("MW", 0),
        ("W", 1),
        ("WMT", 0),
        ("MT", -1),
        ("MTW", 0),
        ("MTWW", 1),
        ("MMT", -2),
        ("MMTW", -1),
        ("MMTWW", 0),
        ("MTMT", -2),
        ("WW", 2),
        ("WWMT", 1),
        ("WWMTMT", 0),
        ("WMMT", -1),
        ("WMMTWMW", 0),
    ],
)
async def test_as_many_are_looked_for_as_were_heard_of_and_not_taken(counted: Counted, steps: str, left: int) -> None:
    for step in steps:
        counted.step(step)
    assert counted.left == ({K: left} if left else {})
    assert counted.taker.taken == [K] * steps.count("M")
    assert counted.inbox._poll_again.armed or left <= 0


@pytest.mark.parametrize(
    ("waiting", "all_rings"), [(OTHER_DEPTH - 3, False), (OTHER_DEPTH - 2, True), (OTHER_DEPTH + 3, True)]
)
async def test_a_wakeup_that_may_have_lost_some_has_all_rings_read(
    counted: Counted, waiting: int, all_rings: bool
) -> None:
    """Whoever was missed before is among them; they are looked at once more, after the flood's next tick."""
    counted.step("W", FURTHER)
    counted.rings[OTHER].put(Sample(OTHER))
    wakeups = [named(K)] * waiting
    counted.inbox._wakeups = (SimpleNamespace(try_recv=lambda: wakeups.pop() if wakeups else None),)
    counted.step("W")
    assert len(wakeups) == max(0, waiting - OTHER_DEPTH), "what comes meanwhile is left for the next time"
    assert counted.taker.taken == [OTHER] * all_rings
    assert counted.left == ({} if all_rings else {FURTHER: 1, K: waiting + 1})
    assert counted.inbox._attempt == (POLL_AFTER_FLOOD if all_rings else 0)
    assert not counted.inbox._read_all, "at the next tick those that were heard of are read"
    if all_rings:
        counted.step("M", FURTHER)
        counted.inbox._poll_now()
        assert counted.taker.taken == [OTHER, FURTHER]
        for _ in range(POLL_AFTER_FLOOD + 1, len(POLL_AGAIN_S)):
            assert counted.inbox._lost_some
            counted.inbox._poll_now()
        assert not counted.inbox._lost_some


async def test_what_was_passed_over_in_a_full_ring_and_what_names_no_key_of_ours_is_not_counted(
    counted: Counted,
) -> None:
    for _ in range(LEAST_PUT_DEPTH):
        counted.rings[K].put(Sample(K))
    begun_ns = time.monotonic_ns()
    with counted.taker.owner:
        lost, *newest = counted.inbox.take()
    assert (lost.verb, lost.size) == (Verb.LOST, LEAST_PUT_DEPTH - RING_DEPTH)
    assert [each.verb for each in newest] == [Verb.PUT] * RING_DEPTH
    assert begun_ns <= newest[0].received_ns <= time.monotonic_ns()
    assert newest[0].size == 0
    assert counted.left == {K: -RING_DEPTH}
    with counted.taker.owner:
        counted.inbox._note(Sample("hexapod/x/cmd"), 7)
        (unknown,) = counted.inbox.take()
    assert (unknown.target, unknown.received_ns) == (None, 7)
    assert counted.left == {K: -RING_DEPTH}


async def test_it_is_closed_when_none_of_its_threads_has_anything_in_hand() -> None:
    counted = Counted()
    assert counted.inbox.makes_progress()
    closing = threading.Thread(target=counted.inbox.close)
    with counted.taker.owner:
        counted.rings[ESTOP].put(Sample(ESTOP))  # its thread waits for the state
        closing.start()
        closing.join(0.1)
        assert closing.is_alive()
    closing.join(PATIENCE_S)
    assert not any(thread.is_alive() for thread in counted.inbox._threads)
    assert [each.key for each in counted.taker.estops] == [ESTOP]
