"""The real gateway, from received messages to the controller, in virtual time and without asyncio's loop: so the whole
scene can be copied at any moment, and each copy be given another fault."""

import asyncio
import copy
import heapq
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Self, cast

from pydantic import BaseModel

from gateway.model.frames import Frame
from gateway.model.framing import Framing
from gateway.robot.blackbox.recorder import Recorder
from gateway.robot.core.message import Received, Verb
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.protocol import BatchReport
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.service import BEAT_S, rules
from gateway.robot.settings import Settings
from gateway.robot.spi import Batch, SpiDevice
from gateway.robot.spi.bus import CS_CHANGE_NS, Bus
from gateway.robot.spi.simulator import SimulatedController
from schemas import keys
from tests.deaf.minute import Message
from tests.deaf.watcher import Watcher

MS = 1_000_000
BEGIN_NS = 10_000 * MS
BYTE_NS = 3_200
"""At 2.5 MHz."""
CALL_NS = 25_000
"""About what a call takes beside what the wire needs."""


class Timer:
    """A call that is due at a time."""

    def __init__(self, when_ns: int, callback: Callable[..., object], arguments: tuple[object, ...]) -> None:
        self.when_ns = when_ns
        self._call: tuple[Callable[..., object], tuple[object, ...]] | None = (callback, arguments)

    def cancel(self) -> None:
        self._call = None

    def cancelled(self) -> bool:
        return self._call is None

    def run(self) -> None:
        if self._call is not None:
            callback, arguments = self._call
            callback(*arguments)


class VirtualLoop:
    """What a conductor wants of a loop, in virtual time; unlike asyncio's, it can be copied."""

    def __init__(self) -> None:
        self.clock_ns = BEGIN_NS
        self._timers: list[tuple[int, int, Timer]] = []
        self._count = 0

    @property
    def next_ns(self) -> float:
        """When the next timer is due."""
        return self._timers[0][0] if self._timers else math.inf

    def now_ns(self) -> int:
        return self.clock_ns

    def time(self) -> float:
        return self.clock_ns / 1e9

    def at_ns(self, when_ns: int, callback: Callable[..., object], *arguments: object) -> Timer:
        timer = Timer(when_ns, callback, arguments)
        self._count += 1
        heapq.heappush(self._timers, (when_ns, self._count, timer))
        return timer

    def call_at(self, when_s: float, callback: Callable[..., object], *arguments: object) -> Timer:
        return self.at_ns(round(when_s * 1e9), callback, *arguments)

    def call_later(self, delay_s: float, callback: Callable[..., object], *arguments: object) -> Timer:
        return self.at_ns(self.clock_ns + round(delay_s * 1e9), callback, *arguments)

    def step(self) -> None:
        """Run the next timer."""
        when_ns, _, timer = heapq.heappop(self._timers)
        self.clock_ns = max(self.clock_ns, when_ns)
        timer.run()


class Written(NamedTuple):
    """A transfer as it was recorded."""

    at_ns: int
    data: bytes
    repeat: bool
    """Whether it is part of a repeated run of Stops."""


class MarkedBus(Bus):
    """A bus that says of each batch whether it repeats Stops."""

    repeating = False

    def write(self, frames: Sequence[Frame], *, preamble: bool = False) -> BatchReport:
        self.repeating = preamble
        return super().write(frames, preamble=preamble)


class Waiting(deque[Received]):
    """The inbox's side: messages that wait for the next tick."""

    instant_open = False

    def take(self) -> Iterator[Received]:
        while self:
            yield self.popleft()


class Scene(SpiDevice):
    """A gateway, its controller, and a watcher of both; messages come at their times."""

    def __init__(self, messages: Sequence[Message], *, tick_phase_ns: int = 0) -> None:
        self.settings = Settings.of({"spi": {"framing": "length-prefixed"}})
        self.loop = VirtualLoop()
        self.controller = SimulatedController(
            Framing.LENGTH_PREFIXED, clock=self.loop.now_ns, tick_phase_ns=tick_phase_ns
        )
        self.watcher = Watcher(self.controller)
        self.log: list[Written] = []
        self._messages = messages
        self._next_message = 0
        self.transfers = 0
        self.calls: list[int] = []
        """The first transfer of each call since the last copy."""
        self._stall: tuple[int, int] | None = None
        self._waiting = Waiting()
        self.bus = MarkedBus(self.settings.spi, self._open, clock=self.loop.now_ns)
        self.conductor = Conductor(
            self.settings,
            Supervisor(replace(rules(self.settings), start_wait_ns=0)),
            self.bus,
            self,
            cast(asyncio.AbstractEventLoop, self.loop),
            clock=self.loop.now_ns,
            recorder=Recorder(self.settings, {}, self.loop.now_ns, self.loop.now_ns),
            simulated=True,
        )
        self.conductor.connect(self._waiting)
        self.conductor.start()
        self._beat()

    # ---- the gateway's surroundings

    def _beat(self) -> None:
        """The service's."""
        self.conductor.turned()
        self.loop.call_later(BEAT_S, self._beat)

    def publish(self, key: str, report: BaseModel) -> None:
        """The outbox's side: nobody listens."""

    def _receive(self, message: Message) -> None:
        fields: dict[str, Any] = {
            "key": message.key,
            "expression": message.key,
            "target": keys.COMMAND_KEYS.get(message.key),
            "verb": Verb.PUT,
            "payload": message.payload,
            "size": len(message.payload),
            "encoding": "application/json",
            "source": None,
            "received_ns": self.loop.now_ns(),
        }
        self._waiting.append(Received(**fields))
        self.conductor.tick()

    def _open(self) -> Self:
        return self

    # ---- the device

    def transfer(self, batch: Batch) -> None:
        """Nothing stands still within a call."""
        self._stand_still()
        self.calls.append(self.transfers)
        self.loop.clock_ns += CALL_NS
        for data, pause_us in batch:
            self.take(data)
            self.loop.clock_ns += BYTE_NS * len(data) + pause_us * 1000 + CS_CHANGE_NS

    def take(self, data: bytes) -> None:
        repeat = self.bus.repeating and len(data) > 1
        self.log.append(Written(self.loop.clock_ns, data, repeat))
        self.controller.take(data)
        self.watcher.saw(self.loop.clock_ns, data, repeat=repeat)
        self.transfers += 1

    def _stand_still(self) -> None:
        if self._stall is not None and self.transfers == self._stall[0]:
            self.loop.clock_ns += self._stall[1]
            self.watcher.fault_ns = self.loop.clock_ns
            self._stall = None

    # ---- time

    def step(self) -> bool:
        """The next message or timer; false where neither will ever come."""
        self.bus.repeating = False
        message_ns = math.inf
        if self._next_message < len(self._messages):
            message = self._messages[self._next_message]
            message_ns = BEGIN_NS + round(message.at_ms * MS)
        if message_ns < self.loop.next_ns:
            self._next_message += 1
            self.loop.clock_ns = max(self.loop.clock_ns, int(message_ns))
            self._receive(message)
        elif self.loop.next_ns < math.inf:
            self.loop.step()
        else:
            return False
        return True

    def run_until(self, end_ns: int) -> None:
        while self.loop.clock_ns < end_ns and self.step():
            pass

    def copy(self) -> "Scene":
        """Another one that goes on from here by itself. What only counts, or is never changed, is shared."""
        self.log.clear()
        self.calls.clear()
        self.controller.transfers.clear()
        counts = (self.conductor.metrics, self.bus.transfer_latency)
        shared = (self.settings, self._messages, *counts, self.conductor.owner)  # one thread needs no lock of its own
        return copy.deepcopy(self, {id(each): each for each in shared})

    def stall_at(self, transfer: int, duration_ns: int) -> None:
        """Let the machine stand still before the call that begins with that transfer, counted from the start."""
        self._stall = transfer, duration_ns
