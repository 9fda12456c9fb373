"""Which question is read next, and which is let go."""

import json
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, cast

import pytest

from gateway.allowance import MOST_SOURCES, NS_PER_S
from gateway.robot.zenoh_io import questions

DRIVER, KITCHEN = "d" * 32, "b" * 32
CHALLENGE = {"do": "challenge"}


@dataclass
class Asked:
    """Those who ask, in virtual time."""

    now_ns: int = 0

    def __post_init__(self) -> None:
        self.questions: questions.Questions[str] = questions.Questions({DRIVER, KITCHEN}.__contains__)

    def ask(self, name: str, payload: dict[str, Any], source: str | None = None) -> bool:
        return self.questions.add(name, json.dumps(payload).encode(), source, self.now_ns)

    def read(self) -> list[str]:
        found = []
        while (item := self.questions.next()) is not None:
            found.append(item)
        return found


@pytest.fixture
def asked() -> Asked:
    return Asked()


def test_a_flood_of_others_keeps_no_good_token_out(asked: Asked) -> None:
    assert sum(asked.ask("flood", CHALLENGE) for _ in range(10_000)) == questions.MAX_WITHOUT_TOKEN
    assert asked.ask("renewal", {"do": "renew", "lease": DRIVER})
    assert asked.read()[0] == "renewal"


def test_a_flood_by_one_token_keeps_no_other_out(asked: Asked) -> None:
    kitchen = {"do": "alive", "button": KITCHEN, "count": 1}
    assert sum(asked.ask("kitchen", kitchen) for _ in range(100)) == questions.MOST_OF_TOKEN
    assert asked.ask("renewal", {"do": "renew", "lease": DRIVER})
    assert asked.read() == ["kitchen"] * questions.MOST_OF_TOKEN + ["renewal"]
    assert sum(asked.ask("kitchen", kitchen) for _ in range(100)) == questions.MOST_OF_TOKEN, "those were read"


def test_ever_new_sources_share_one_place_and_take_bounded_memory(asked: Asked) -> None:
    count = 0
    for number in range(1000):
        count += asked.ask("", CHALLENGE, f"source {number}")
        asked.read()
    assert count == MOST_SOURCES + questions.QUESTIONS_AT_ONCE
    asked.now_ns += NS_PER_S
    assert asked.ask("", CHALLENGE, "a new one"), "those that asked before are forgotten"


def test_a_ring_is_not_polled_before_its_wakeup_and_again_until_the_query_is_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Zenoh delivers the wakeup and the query one after the other, in any order."""
    waits_s: list[float | None] = []
    found = iter((None, None, None, "query", "next"))

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
    assert waits_s == [None, *questions.POLL_AGAIN_S[:2]]
    assert cast(str, ring.recv()) == "next"
    assert len(waits_s) == 3


def test_a_flood_of_wakeups_takes_bounded_memory() -> None:
    ring = questions.WokenRing(cast(Any, None))
    for _ in range(2 * questions.MOST_WAKES):
        ring.wake()
    assert ring._wakes.qsize() == questions.MOST_WAKES
