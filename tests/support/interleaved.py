"""A gateway's threads, one at a time: the test chooses which continues at each lock, ring and transfer.

The threads are real, and so are the conductor, the inbox and its receiver threads. Locks, rings, loop and device are
small ones that give way at each use. So every order in which threads can own the state can be had, and had again.
"""

import heapq
import math
import queue
import threading
from collections import defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

import zenoh

from gateway.model.frames import Framing
from gateway.robot.spi import Batch
from tests.support.controllers import Controller

PATIENCE_S: Final = 10.0
"""A thread that reaches no further point in this time hangs."""


@dataclass
class _Actor:
    name: str
    go: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    ready: Callable[[], bool] = bool
    waits_for: str = ""
    ended: bool = False


class Stage:
    """Lets one thread go on at a time."""

    def __init__(self, choose: Callable[[list[str]], str]) -> None:
        """`choose` is given the names of the threads that can go on."""
        self._choose = choose
        self._actors: dict[int, _Actor] = {}
        self._parked = threading.Semaphore(0)
        self._tests = threading.get_ident()
        self.over = False
        self.failures: list[BaseException] = []

    def start(self, name: str, act: Callable[[], None]) -> None:
        """Add one more thread."""

        def run() -> None:
            self.point()
            try:
                act()
            except BaseException as error:
                self.failures.append(error)
            self._actors[threading.get_ident()].ended = True
            self._parked.release()

        threading.Thread(target=run, name=name, daemon=True).start()

    def point(self, waits_for: str = "", ready: Callable[[], bool] = lambda: True) -> None:
        """Wait, on a thread, until it is chosen and `ready`. The test's own thread continues at once."""
        if self.over or threading.get_ident() == self._tests:
            return
        actor = self._actors.setdefault(threading.get_ident(), _Actor(threading.current_thread().name))
        actor.ready, actor.waits_for = ready, waits_for
        self._parked.release()
        actor.go.acquire()

    def _wait(self, count: int) -> None:
        """Wait until so many more threads have come to a point."""
        for _ in range(count):
            assert self._parked.acquire(timeout=PATIENCE_S), "a thread hangs"

    def run(self, count: int) -> None:
        """Run so many threads until none of them can continue. None may then wait for a lock."""
        self._wait(count)
        while True:
            can = {actor.name: actor for actor in self._actors.values() if not actor.ended and actor.ready()}
            if not can:
                break
            can[self._choose(sorted(can))].go.release()
            self._wait(1)
        stuck = [actor.name for actor in self._actors.values() if not actor.ended and actor.waits_for == "lock"]
        assert not stuck, f"deadlock: {stuck}"

    def end(self) -> None:
        """Let all continue until they end."""
        self.over = True
        for actor in self._actors.values():
            actor.go.release()


class SteppedLock:
    """A lock that is unfair, as Python's: any thread may take it before the one that has waited longest."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self.held_by: str | None = None

    def acquire(self) -> None:
        self._stage.point("lock", lambda: self.held_by is None)
        assert self.held_by is None or self._stage.over
        self.held_by = threading.current_thread().name

    def release(self) -> None:
        self.held_by = None
        self._stage.point()

    def __enter__(self) -> None:
        self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class Payload(bytes):
    """A sample's payload, as far as the inbox reads it."""

    def to_bytes(self) -> bytes:
        return self


@dataclass
class Sample:
    """A sample of Zenoh, as far as the inbox reads it."""

    key_expr: str
    payload: Payload = field(default_factory=Payload)
    encoding: str = "application/json"
    source_info: None = None
    kind = zenoh.SampleKind.PUT


class Ring:
    """A subscriber and its ring in one."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self.handler = self
        self.items: deque[Any] = deque()
        self.on_receive: Callable[[], object] = bool

    def recv(self) -> Any:
        self._stage.point("ring", lambda: bool(self.items))
        if self._stage.over:
            raise zenoh.ZError("closed")
        self.on_receive()
        return self.items.popleft()

    def try_recv(self) -> Any:
        return self.items.popleft() if self.items else None

    def undeclare(self) -> None:
        """Do nothing: the stage's end ends it."""


class Wakeups:
    """A queue: a thread that waits for it with a timeout may continue at any time."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._count = 0

    def qsize(self) -> int:
        return self._count

    def put(self, _: bool) -> None:
        self._count += 1

    def get(self, timeout: float) -> bool:
        self._stage.point("queue", lambda: self._count > 0 or timeout < 1)  # no second passes
        if self._stage.over:
            raise zenoh.ZError("closed")
        if not self._count:
            raise queue.Empty
        self._count -= 1
        return True


class Rings:
    """A session, as far as the inbox needs one: its rings."""

    def __init__(self, stage: Stage) -> None:
        self.puts = defaultdict[str, Ring](partial(Ring, stage))
        self.gets = defaultdict[str, Ring](partial(Ring, stage))

    def declare_subscriber(self, key: str, _: object) -> Ring:
        return self.puts[key]

    def declare_queryable(self, key: str, _: object) -> Ring:
        return self.gets[key]


@dataclass
class Timer:
    """A timer of a loop."""

    run: Callable[[], object]
    cancelled: bool = False

    def cancel(self) -> None:
        self.cancelled = True


class SteppedLoop:
    """An event loop, as far as the gateway's owners use one. Its time passes when it has nothing else to do."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._ready: deque[Timer] = deque()
        self._timers: list[tuple[float, int, Timer]] = []
        self._count = 0
        self.now_s = 1.0
        self.failures: list[object] = []

    def time(self) -> float:
        return self.now_s

    def call_at(self, when_s: float, call: Callable[..., object], *arguments: object) -> Timer:
        self._count += 1
        timer = Timer(partial(call, *arguments))
        heapq.heappush(self._timers, (when_s, self._count, timer))
        return timer

    def call_soon_threadsafe(self, call: Callable[..., object], *arguments: object) -> Timer:
        timer = Timer(partial(call, *arguments))
        self._ready.append(timer)
        return timer

    def call_exception_handler(self, context: dict[str, object]) -> None:
        self.failures.append(context["exception"])

    def run(self) -> None:
        """Run on a thread of the stage's, until that is over."""
        while True:
            self._stage.point("work", lambda: bool(self._ready) or self._next_s < math.inf)
            if self._stage.over:
                return
            self.step()

    def step(self) -> bool:
        """Do the next item. Return False if there is none."""
        if self._ready:
            self._ready.popleft().run()
        elif self._next_s < math.inf:
            when_s, _, timer = heapq.heappop(self._timers)
            self.now_s = max(self.now_s, when_s)
            timer.run()
        else:
            return False
        return True

    @property
    def _next_s(self) -> float:
        while self._timers and self._timers[0][2].cancelled:
            heapq.heappop(self._timers)
        return self._timers[0][0] if self._timers else math.inf


class SteppedController(Controller):
    """A controller that gives way before each batch, in which no other thread may write."""

    def __init__(self, stage: Stage, clock: Callable[[], int]) -> None:
        super().__init__(Framing.PLAIN, clock=clock)
        self._stage = stage
        self._writes = False

    def transfer(self, batch: Batch) -> None:
        assert not self._writes, "two threads write at once"
        self._writes = True
        self._stage.point()
        super().transfer(batch)
        self._writes = False
