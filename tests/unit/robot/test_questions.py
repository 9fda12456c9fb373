"""Which question is read next, and which is let go."""

import json
from collections import deque
from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any, cast

import pytest
import zenoh

from gateway.rate_limit import MOST_SOURCES, NS_PER_S
from gateway.robot.zenoh_io import questions

DRIVER, KITCHEN = "d" * 32, "b" * 32
CHALLENGE = {"do": "challenge"}


class Asked:
    """A ring, as Zenoh fills it, with those who ask, in virtual time."""

    def __init__(self) -> None:
        self.now_ns = 0
        self._waiting: deque[Any] = deque(maxlen=questions.QUESTIONS_DEPTH)
        endings: Any = SimpleNamespace(waiting=0, do=lambda end: end())
        self.ring = questions.QuestionRing(
            cast(Any, self), {DRIVER, KITCHEN}.__contains__, lambda: self.now_ns, endings
        )

    def ask(self, name: str, payload: dict[str, Any], source: str | None = None) -> None:
        info = None if source is None else SimpleNamespace(source_id=SimpleNamespace(zid=source))
        sent = zenoh.ZBytes(json.dumps(payload))
        self._waiting.append(SimpleNamespace(name=name, payload=sent, source_info=info, drop=lambda: None))

    def try_recv(self) -> Any:
        return self._waiting.popleft() if self._waiting else None

    def read(self) -> list[str]:
        found: list[str] = []
        while (query := cast(Any, self.ring.try_recv())) is not None:
            found.append(query.name)
        return found


@pytest.fixture
def asked() -> Asked:
    return Asked()


def test_a_flood_of_others_keeps_no_good_token_out(asked: Asked) -> None:
    for _ in range(10_000):
        asked.ask("flood", CHALLENGE)
    asked.ask("renewal", {"do": "renew", "lease": DRIVER})
    assert asked.read() == ["renewal"] + ["flood"] * questions.MAX_WITHOUT_TOKEN


def test_a_flood_by_one_token_keeps_no_other_out(asked: Asked) -> None:
    for _ in range(2):  # those were read
        for _ in range(100):
            asked.ask("kitchen", {"do": "alive", "button": KITCHEN, "count": 1})
        asked.ask("renewal", {"do": "renew", "lease": DRIVER})
        assert asked.read() == ["kitchen"] * questions.MOST_OF_TOKEN + ["renewal"]


def test_ever_new_sources_share_one_place_and_take_bounded_memory(asked: Asked) -> None:
    count = 0
    for number in range(1000):
        asked.ask("", CHALLENGE, f"source {number}")
        count += len(asked.read())
    assert count == MOST_SOURCES + questions.QUESTIONS_AT_ONCE
    asked.now_ns += NS_PER_S
    asked.ask("", CHALLENGE, "a new one")
    assert asked.read() == [""], "those that asked before are forgotten"


def test_a_ring_is_polled_after_its_wakeup_until_the_query_is_there_and_every_ten_seconds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Zenoh delivers the wakeup and the query one after the other, in any order, and perhaps much later."""
    waits_s: list[float | None] = []
    found = iter((*[None] * 9, "query", "next"))

    class Wakeups(SimpleQueue[bool]):
        def get(self, block: bool = True, timeout: float | None = None) -> bool:
            waits_s.append(timeout)
            return super().get(block and timeout is None)

    class Ring:
        def try_recv(self) -> str | None:
            return next(found)

    monkeypatch.setattr(questions, "SimpleQueue", Wakeups)
    ring = questions.WokenRing(cast(Any, Ring()))
    ring.wake()
    assert cast(str, ring.recv()) == "query"
    assert waits_s == [10, 0.0002, 0.001, 0.004, 0.016, 0.064, 0.25, 1, 10]
    assert cast(str, ring.recv()) == "next"
    assert len(waits_s) == 9


def test_a_flood_of_wakeups_takes_bounded_memory() -> None:
    ring = questions.WokenRing(cast(Any, None))
    for _ in range(2 * questions.MOST_WAKES):
        ring.wake()
    assert ring._wakes.qsize() == questions.MOST_WAKES
