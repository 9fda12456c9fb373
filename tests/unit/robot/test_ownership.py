"""Who owns the state: a gateway's threads, in many of the orders in which they can meet."""

import asyncio
import random
import threading
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import Any, cast

import pytest
import zenoh

from gateway.host.realtime import RECEIVER_PRIORITY
from gateway.model.frames import decode
from gateway.robot.blackbox.recorder import Recorder
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.host.ownership import Ownership
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.service import BEAT_S, rules
from gateway.robot.settings import Settings
from gateway.robot.spi.bus import Bus
from gateway.robot.zenoh_io import questions
from gateway.robot.zenoh_io.inbox import Inbox
from gateway.robot.zenoh_io.receiver import STUCK_BEATS, ReceiverThread
from schemas import keys
from schemas.state import StateReport
from schemas.words import Mode
from tests.support.interleaved import (
    PATIENCE_S,
    Payload,
    Ring,
    Rings,
    Sample,
    Stage,
    SteppedController,
    SteppedLock,
    SteppedLoop,
    Wakeups,
)

pytestmark = pytest.mark.full

START = Payload(b'{"servos": [' + b", ".join([b'{"op": "start", "angle_deg": 90}'] * 3) + b"]}")
RECEIVERS = ("estop-put", "estop-get", "wakeup-put", "wakeup-get", f"{keys.STATE}-get")
ORDERS = 150


class Question(nullcontext[None]):
    """A query for the state."""

    key_expr = keys.STATE

    def __init__(self, answers: list[bytes]) -> None:
        super().__init__()
        self._answers = answers

    def reply(self, _key: str, payload: bytes, **_: object) -> None:
        self._answers.append(payload)

    def drop(self) -> None:
        """Nobody waits."""


@pytest.fixture(autouse=True)
def _questions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zenoh, "Query", Question)


def stepped(stage: Stage) -> Ownership:
    return Ownership(cast(Any, lambda: SteppedLock(stage)))


class Gateway:
    """A conductor and an inbox, with the threads that the service gives them, on a stage."""

    def __init__(self, order: int) -> None:
        chance = random.Random(order)  # noqa: S311  (orders, no secrets)
        # Threads that are mostly preferred, and threads that are hardly ever, make the rarest orders.
        weights = {name: chance.choice((1, 1, 10, 100)) for name in (*RECEIVERS, "loop", "others", "end")}
        self._looks = 0
        self.stage = Stage(lambda names: chance.choices(names, [weights[name] for name in names])[0])
        self.loop = SteppedLoop(self.stage)
        self.rings = Rings(self.stage)
        self.controller = SteppedController(self.stage, self.now_ns)
        self.settings = Settings.of({"spi": {"frame_gap_us": 0}})
        self.answers: list[bytes] = []
        self.noted: list[int] = []
        """How many frames had been written when an emergency stop's own thread received it."""
        loop = cast(asyncio.AbstractEventLoop, self.loop)
        # No runs of Stops at rest: nobody beats here, so to wait a second for one is to stand still.
        supervisor = Supervisor(replace(rules(self.settings), rest_runs=0, start_wait_ns=0))
        self.conductor = Conductor(
            self.settings,
            supervisor,
            Bus(self.settings.spi, lambda: self.controller, clock=self.now_ns),
            self,
            loop,
            clock=self.now_ns,
            recorder=Recorder(self.settings, {}, self.now_ns, self.now_ns),
            owner=stepped(self.stage),
        )
        with self.conductor.owner, pytest.MonkeyPatch.context() as patch:
            patch.setattr(questions, "SimpleQueue", partial(Wakeups, self.stage))
            self.conductor.start()
            self.inbox = Inbox(
                cast(Any, self.rings),
                loop,
                self.conductor.owner,
                on_wakeup=self.conductor.tick,
                on_estop=self.conductor.serve_estops,
                readers={
                    keys.STATE: lambda _query, _ns, reply: partial(self.conductor.reports.answer, keys.STATE, reply)
                },
            )
            self.conductor.messages = self.inbox
        self.rings.puts[keys.ESTOP].on_receive = lambda: self.noted.append(len(self.controller.transfers))

    def now_ns(self) -> int:
        self._looks += 1  # no two instants are the same by accident
        return round(self.loop.now_s * 1e9) + self._looks

    def publish(self, key: str, report: object) -> None:
        """Nobody listens."""

    def play(self, *then: Callable[[], None]) -> None:
        """Play the whole of it, until nothing is left to happen."""
        self.stage.start("loop", self.loop.run)
        for each in then:
            self.stage.start(each.__name__, each)
        self.stage.run(1 + len(RECEIVERS) + len(then))
        assert not self.stage.failures
        assert not self.loop.failures
        self.stage.end()
        for thread in self.inbox._receivers:
            thread.thread.join(PATIENCE_S)
        for worker in self.inbox._workers:
            worker.close()

    # ---- what Zenoh's threads do: two deliveries of each message, one after the other

    def put(self, key: str, payload: Payload) -> None:
        self._deliver(Sample(key, payload), self.rings.puts[key], self.rings.puts[keys.ALL_COMMANDS])

    def ask_state(self) -> None:
        self._deliver(Question(self.answers), self.rings.gets[keys.STATE], self.rings.gets[f"{keys.ROOT}/**"])

    def _deliver(self, what: object, *rings: Ring) -> None:
        for ring in rings:
            self.stage.point()
            ring.items.append(what)

    @property
    def kinds(self) -> list[bool]:
        """Return of each written frame whether it is a Stop."""
        return [decode(data).is_stop for _, data in self.controller.transfers]


@pytest.mark.parametrize("order", range(ORDERS))
def test_whoever_owns_the_state_serves_an_emergency_stop_before_the_next_command(order: int) -> None:
    gateway = Gateway(order)

    def others() -> None:
        for number in (1, 2, 3):
            gateway.put(keys.leg_command(number), START)
        gateway.ask_state()
        gateway.put(keys.ESTOP, Payload())
        gateway.put(keys.leg_command(4), START)

    gateway.play(others)
    assert gateway.conductor.supervisor.mode is Mode.ESTOPPED
    assert gateway.controller.energised == set()
    assert gateway.conductor.supervisor.latch.number == 1, "noted once, served once"
    (noted,) = gateway.noted
    assert gateway.kinds[noted:].count(False) <= 1, "the frame that was under way"
    (state,) = map(StateReport.model_validate_json, gateway.answers)
    assert state.config == gateway.conductor.reports.config().config


@pytest.mark.parametrize("order", range(ORDERS))
def test_no_deadline_is_overslept_whichever_thread_set_it(order: int) -> None:
    gateway = Gateway(order)

    def others() -> None:
        gateway.put(keys.leg_command(1), START)
        gateway.put(keys.leg_command(2), START)

    gateway.play(others)
    assert gateway.conductor.supervisor.watchdog.expirations == 2
    assert gateway.controller.energised == set()
    late_us = gateway.conductor.metrics.watchdog_stops.max_us
    assert late_us is not None
    assert late_us < 1, "time passes only when the loop waits for it"


@pytest.mark.parametrize("order", range(ORDERS))
def test_after_the_end_nothing_is_written(order: int) -> None:
    gateway = Gateway(order)
    written: list[int] = []

    def others() -> None:
        gateway.put(keys.leg_command(1), START)
        gateway.put(keys.ESTOP, Payload())
        gateway.put(keys.leg_command(2), START)

    def end() -> None:
        with gateway.conductor.owner:
            assert gateway.conductor.shut_down()
            written.append(len(gateway.controller.transfers))
        with gateway.conductor.owner:
            gateway.conductor.close()
            written.append(len(gateway.controller.transfers))

    gateway.play(others, end)
    assert gateway.controller.energised == set()
    assert all(gateway.kinds[written[0] :])
    assert len(gateway.controller.transfers) == written[1]
    assert gateway.conductor.bus.errors == 0, "nobody tried, either"


# ---- the lock, the timers and the threads by themselves


def test_whoever_waits_is_next_although_the_owner_takes_it_again_at_once() -> None:
    owners: list[str] = []

    def choose(names: list[str]) -> str:
        """Choose the patient thread while the other owns the state, else the other."""
        owned = cast(Any, owner)._state.held_by == "greedy"
        return "patient" if names == ["patient"] or (owned and "patient" in names) else "greedy"

    def greedy() -> None:
        for _ in range(20):
            with owner:
                owners.append("greedy")

    def patient() -> None:
        with owner:
            owners.append("patient")

    stage = Stage(choose)
    owner = stepped(stage)
    stage.start("greedy", greedy)
    stage.start("patient", patient)
    stage.run(2)
    assert not stage.failures
    assert owners == ["greedy", "patient", *["greedy"] * 19]


Parts = tuple[ReceiverThread, Stage, SteppedLoop]
Receiving = Callable[[Callable[..., Callable[[], float | None]]], Parts]


@pytest.fixture
def receiving() -> Iterator[Receiving]:
    stage = Stage(lambda names: names[0])
    loop, ring, started = SteppedLoop(stage), Ring(stage), list[ReceiverThread]()

    def start(note: Callable[[object, int], Callable[[], float | None]]) -> Parts:
        ring.items += [b"", b""]
        owner = Ownership()
        started.append(ReceiverThread(cast(Any, loop), owner, "receiver", cast(Any, ring), cast(Any, note)))
        return started[0], stage, loop

    yield start
    assert not ring.items
    stage.end()
    started[0].thread.join(PATIENCE_S)
    assert not started[0].makes_progress()


@pytest.mark.parametrize("where", ["before it owns the state", "as its owner"])
def test_a_mistake_on_a_receiver_thread_is_one_of_the_services_and_it_hears_on(
    where: str, receiving: Receiving
) -> None:
    error = RuntimeError("planted")

    def fail() -> None:
        raise error

    def note(*_: object) -> Callable[[], None]:
        if where.startswith("before"):
            fail()
        return fail

    made, stage, loop = receiving(note)
    stage.run(1)
    while loop.step():
        pass
    assert loop.failures == [error, error]
    assert made.makes_progress()


def test_a_receiver_thread_has_its_priority_and_pauses_where_it_is_asked_to(
    monkeypatch: pytest.MonkeyPatch, receiving: Receiving
) -> None:
    priorities: list[int] = []
    slept_s: list[float] = []
    monkeypatch.setattr("gateway.robot.zenoh_io.receiver.prefer_thread", priorities.append)
    monkeypatch.setattr("gateway.robot.zenoh_io.receiver.time.sleep", slept_s.append)
    pauses_s = [None, 0.25]
    made, stage, _ = receiving(lambda *_: pauses_s.pop)
    stage.run(1)
    assert (priorities, slept_s) == ([RECEIVER_PRIORITY], [0.25])
    assert (made.thread.name, made.thread.daemon) == ("receiver", True), "a stuck one does not keep the process"


def test_a_receiver_thread_that_never_comes_back_from_a_message_is_noticed(receiving: Receiving) -> None:
    stuck, entered = threading.Event(), threading.Event()

    def wait() -> None:
        entered.set()
        stuck.wait(PATIENCE_S)

    made, stage, _ = receiving(lambda *_: wait)
    assert 2.99 < STUCK_BEATS * BEAT_S < 3.01
    assert all(made.makes_progress() for _ in range(2 * STUCK_BEATS)), "that nothing comes is no reason"
    runs = threading.Thread(target=lambda: stage.run(1))
    runs.start()
    assert entered.wait(PATIENCE_S)
    assert [made.makes_progress() for _ in range(STUCK_BEATS + 1)] == [True] * STUCK_BEATS + [False]
    stuck.set()
    runs.join(PATIENCE_S)
    assert all(made.makes_progress() for _ in range(2 * STUCK_BEATS)), "nor that nothing comes any more"
