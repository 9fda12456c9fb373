"""A laptop: streams setpoints to a gateway, and does what a test asks of it (tests/support/acting.py).

    python -m tests.net.publisher ENDPOINT NAME

It also subscribes to all that the gateway reports. A laptop would have processors of its own, so where it may, it comes
before the rest of this machine; but not when it floods.
"""

import json
import os
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import cycle
from typing import Any

import zenoh
from zenoh.handlers import FifoChannel, RingChannel

from gateway.client import Client, leg_payload
from gateway.errors import ZenohError
from schemas.keys import ALIVE, EVENT, FRAME, STATE, leg_command
from tests.support.acting import act

PERIOD_S = 0.02
ANSWER_S = 10
"""Also how long it may take until the gateway has come up."""
BOUND_S = 15
NICE, FLOOD_NICE = -10, 5


@dataclass
class Sent:
    """What was sent since the stream began, and what came back of it."""

    sent: int = 0
    accepted: int = 0
    rejected: int = 0
    unanswered: int = 0
    last_ns: int = 0
    """When the last one was sent (of `ask`: answered), on the monotonic clock."""
    longest_gap_ms: float = 0
    """Between two such times."""
    slowest_ms: float = 0
    """From an acknowledged one to its answer, as the laptop sees it."""


class Streamer:
    """A client of a gateway, with at most one stream."""

    def __init__(self, client: Client, source: str) -> None:
        self._client = client
        self._source = source
        self._thread = threading.Thread()
        self._paused = threading.Event()
        self._changed = threading.Condition()
        self._sent = Sent()
        self._step = 0
        self._in_reach = False
        session = client.session
        self._declared: list[Any] = [session.declare_subscriber(key, RingChannel(1)) for key in (STATE, EVENT, FRAME)]
        self._alive = session.liveliness().declare_subscriber(ALIVE, self._take_alive, history=True)

    def start(self, *legs: int) -> list[bool]:
        """Energise these legs, acknowledged: whether each is accepted."""
        return [self._client.start_leg(leg, *self._angles(), check=False).accepted for leg in legs]

    def stream(self, *legs: int) -> None:
        """From now on, 50 times a second, fire and forget: `set` for each of these legs."""
        self._begin(lambda: self._publish(legs))

    def ask(self, *legs: int) -> None:
        """From now on, 50 times a second, an acknowledged set for one of these legs after the other."""
        each = cycle(legs)
        self._begin(lambda: self._ask(next(each)))

    def flood(self, *legs: int) -> None:
        """From now on, sets for these legs as fast as it can."""
        self._begin(lambda: self._flood([leg_command(leg) for leg in legs]), 0.0, FLOOD_NICE)

    def deaf(self, *legs: int) -> None:
        """From now on, 50 times a second, sets for all of these legs, asking for acknowledgements, while a subscription
        that nobody reads keeps Zenoh from reading anything that the gateway sends."""
        self._declared.append(self._client.session.declare_subscriber(STATE, FifoChannel(1)))
        self._begin(lambda: self._ask_unheard(legs))

    def sent(self, count: int = 0) -> dict[str, float]:
        """Once that many of the stream have been sent: see `Sent`."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._sent.sent >= count, BOUND_S):
                raise TimeoutError(f"only {self._sent} in {BOUND_S} s")
        return asdict(self._sent)

    def pause(self) -> dict[str, float]:
        """The same, and no more of the stream."""
        if self._thread.is_alive():
            self._paused.set()
            self._thread.join()
        return asdict(self._sent)

    def wait_for_reach(self, *, within: bool) -> None:
        """Wait until Zenoh has given the gateway up, or has found it again."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._in_reach is within, BOUND_S):
                raise TimeoutError(f"not in {BOUND_S} s")

    def request(self, what: str) -> dict[str, Any]:
        """`stop`, `estop`, `reset` or `state`; also `answered_ms`: how long the answer took."""
        asked_ns = time.monotonic_ns()
        answer = getattr(self._client, what)().model_dump(mode="json")
        return {**answer, "answered_ms": (time.monotonic_ns() - asked_ns) / 1e6}

    def _begin(self, send: Callable[[], None], period_s: float = PERIOD_S, nice: int = NICE) -> None:
        self.pause()
        set_nice(nice)
        self._sent = Sent()
        self._paused.clear()
        self._thread = threading.Thread(target=self._run, args=(send, period_s))
        self._thread.start()

    def _take_alive(self, sample: zenoh.Sample) -> None:
        with self._changed:
            self._in_reach = sample.kind == zenoh.SampleKind.PUT
            self._changed.notify_all()

    def _run(self, send: Callable[[], None], period_s: float) -> None:
        due_s = time.monotonic()
        while not self._paused.is_set():
            send()
            with self._changed:
                sent, now_ns = self._sent, time.monotonic_ns()
                if sent.last_ns:
                    sent.longest_gap_ms = max(sent.longest_gap_ms, (now_ns - sent.last_ns) / 1e6)
                sent.last_ns = now_ns
                self._changed.notify_all()
            if period_s:
                due_s = max(due_s + period_s, time.monotonic())  # a missed period is skipped, never made up
                self._paused.wait(due_s - time.monotonic())

    def _publish(self, legs: Sequence[int]) -> None:
        for leg in legs:
            self._client.publish(leg_command(leg), leg_payload("set", self._angles()))
            self._sent.sent += 1

    def _flood(self, keys: Sequence[str]) -> None:
        """Many at a time, since nothing is to hold it up but Zenoh."""
        payload = json.dumps({"source": self._source, **leg_payload("set", self._angles())})
        for _ in range(100):
            for key in keys:
                self._client.session.put(key, payload, encoding="application/json")
        self._sent.sent += 100 * len(keys)

    def _ask(self, leg: int) -> None:
        self._sent.sent += 1
        asked_ns = time.monotonic_ns()
        try:
            accepted = self._client.set_leg(leg, *self._angles(), check=False).accepted
        except ZenohError:
            self._sent.unanswered += 1
        else:
            self._sent.accepted += accepted
            self._sent.rejected += not accepted
            self._sent.slowest_ms = max(self._sent.slowest_ms, (time.monotonic_ns() - asked_ns) / 1e6)

    def _ask_unheard(self, legs: Sequence[int]) -> None:
        for leg in legs:
            payload = json.dumps(leg_payload("set", self._angles()))
            self._client.session.get(leg_command(leg), payload=payload, handler=RingChannel(1), timeout=1.0)
            self._sent.sent += 1

    def _angles(self) -> tuple[float, float, float]:
        """Never the same twice in a row."""
        self._step = (self._step + 1) % 9000
        return (45 + self._step / 100, 60, 90)


def set_nice(nice: int) -> None:
    """For all threads of this process, also Zenoh's."""
    for task in os.listdir("/proc/self/task"):
        with suppress(PermissionError, ProcessLookupError):  # a thread may have ended since it was listed
            os.setpriority(os.PRIO_PROCESS, int(task), nice)


def main() -> None:
    endpoint, source = sys.argv[1:]
    set_nice(NICE)
    with Client(endpoint, source=source, timeout_s=ANSWER_S) as client:
        laptop = Streamer(client, source)
        act(laptop)
        laptop.pause()


if __name__ == "__main__":
    main()
