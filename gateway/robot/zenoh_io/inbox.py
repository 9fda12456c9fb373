"""The input edge: Zenoh's subscribers and queryables, a ring for each key, and the threads that wait for them.

Zenoh delivers on its own threads. With a Python callback for each message, a flood of one key would delay everything
else by seconds. So each key has a ring in Rust that keeps its newest messages. One thread waits on a subscriber of all
keys: the wakeup. It then owns the state (`robot.host.ownership`) for a tick, empties the rings, and writes the frames.
Work per tick is bounded, an overwritten message costs nothing, and a command wakes no other thread.

The emergency stop has its own rings and receiver threads, so a flood of other keys does not delay it. Each further key
with questions has its own thread, which waits for a wakeup (`questions.WokenRing`).
"""

import asyncio
import logging
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from functools import partial
from types import MappingProxyType
from typing import Any, Final

import zenoh
from zenoh.handlers import RingChannel

from gateway.host.realtime import LOOP_PRIORITY
from gateway.host.worker import Worker
from gateway.robot.core.intake import words_of_stop
from gateway.robot.core.message import Messages, Received, Reply, Verb
from gateway.robot.host.ownership import Ownership, OwnersTimer
from gateway.robot.zenoh_io.questions import POLL_AGAIN_S, QUESTIONS_DEPTH, QuestionRing, TokenCheck, WokenRing
from gateway.robot.zenoh_io.receiver import OwnersTask, Reader, ReceiverThread
from gateway.robot.zenoh_io.rings import LEAST_PUT_DEPTH, RING_DEPTH, Rings
from schemas.ack import Ack
from schemas.command import MAX_PAYLOAD_BYTES
from schemas.keys import ALL_COMMANDS, COMMAND_KEYS, ESTOP, ROOT
from schemas.words import Reason

OTHER_DEPTH: Final = 16  # mutants accepted (Step): none is the only right one
"""Messages for unknown keys that wait; each is rejected on its own, so more are of no use."""
READER_DEPTH: Final = 32  # mutants accepted (Step): none is the only right one
"""Queries on another key that wait to be read. A query that is pushed out gets no answer, and its sender notices."""
POLL_AFTER_FLOOD: Final = 2  # mutants accepted (Step): none is the only right one
"""The first of these delays after lost wakeups: longer than a flood's next tick, which polls anyway."""

FLOOD_PAUSE_S: Final = 0.001
"""Pause of a wakeup after a tick that found it full. Without the pause, ticks take the processor from Zenoh's receiving
threads, and data waits in their sockets. A flooded leg's frames, p99, on a busy machine: 171 and 181 ms without the
pause, 25 and 50 ms with it."""

_Item = zenoh.Sample | zenoh.Query
_PUT, _DELETE, _KIND_DELETE = Verb.PUT, Verb.DELETE, zenoh.SampleKind.DELETE
"""Read for each message; see `frames.OP_STOP`."""
_RING_KEYS: Final = COMMAND_KEYS.keys() - {ESTOP}
_COMMANDS: Final = zenoh.KeyExpr(ALL_COMMANDS)

logger = logging.getLogger(__name__)


class Inbox(Messages):
    """Receives all messages. An owner of the state calls `take`, and makes its callbacks."""

    # mutants accepted (FalseWithTrue, Forget, Step): set before it is read; any number of equal Stops
    def __init__(
        self,
        session: zenoh.Session,
        loop: asyncio.AbstractEventLoop,
        owner: Ownership,
        *,
        on_wakeup: Callable[[], None],
        on_estop: Callable[[], None],
        readers: Mapping[str, Reader] = MappingProxyType({}),
        tokens: Mapping[str, TokenCheck] = MappingProxyType({}),
        depth: int = LEAST_PUT_DEPTH,
        on_estop_received: Callable[[], object] = lambda: None,
    ) -> None:
        """`on_wakeup` is called if there are messages to `take`; `on_estop` if an emergency stop is in `estops`.

        `on_estop_received` is called first, on the receiving thread without the state: a transfer that hangs may hold
        the state, and the second way to stop must not wait for it.

        `readers` read queries on other keys, each on its own thread without the state. On keys in `tokens`, queries
        with a valid token are read first. `depth` is how many puts of a key are kept (`put_depth`).
        """
        super().__init__()
        self._loop = loop
        self._passed_over = depth - RING_DEPTH  # of a full ring
        self._wake = on_wakeup
        self._serve_estops = on_estop
        self._on_estop_received = on_estop_received
        self._others: deque[Received] = deque()
        self._woken: dict[str, int] = {}
        """Wakeups for each key since the last tick."""
        self._read_all = False
        self._got_wakeup = False
        """Whether a wakeup has come since the latest beat."""
        self.is_quiet = False
        """Whether none had come, and no receiver thread handled an item, at the latest beat."""
        self._poll_again = OwnersTimer(loop, owner, self._poll_now)
        self._attempt = 0
        self._closing = OwnersTimer(loop, owner, on_wakeup)
        self._declared: list[Any] = []
        self._replies = Worker("answers", priority=None)
        self._estop_replies = Worker("estop-answers", priority=None)  # they wait for no other answers
        self._endings = Worker("end questions", priority=None)
        self._workers = (self._replies, self._estop_replies, self._endings)

        self._rings = Rings[_Item, Received](
            {
                key: (
                    self._ring(session.declare_subscriber, key, depth).try_recv,
                    self._ring(session.declare_queryable, key, RING_DEPTH).try_recv,
                )
                for key in COMMAND_KEYS
                if key != ESTOP
            },
            partial(_received, self._replies),
            words_of_stop,
            depth,
        )
        self._wakeups = (
            self._ring(session.declare_subscriber, ALL_COMMANDS, OTHER_DEPTH),
            self._ring(session.declare_queryable, f"{ROOT}/**", OTHER_DEPTH),  # questions, too
        )
        estops = (
            ("estop-put", self._ring(session.declare_subscriber, ESTOP, 1)),
            ("estop-get", self._ring(session.declare_queryable, ESTOP, RING_DEPTH)),
        )
        self._asked: dict[str, WokenRing] = {}
        for key in readers:
            ring = self._ring(session.declare_queryable, key, QUESTIONS_DEPTH if key in tokens else READER_DEPTH)
            self._asked[key] = WokenRing(
                QuestionRing(ring, tokens[key], time.monotonic_ns, self._endings) if key in tokens else ring
            )
        thread = partial(ReceiverThread, loop, owner)
        self._receivers = [
            *(thread(name, ring, self._estop, priority=LOOP_PRIORITY) for name, ring in estops),
            thread("wakeup-put", self._wakeups[0], partial(partial, self._on_wakeup)),
            thread("wakeup-get", self._wakeups[1], partial(partial, self._on_wakeup)),
            *(
                thread(f"{key}-get", self._asked[key], partial(self._note_question, key, read))
                for key, read in readers.items()
            ),
        ]

    def take(self) -> Iterator[Received]:
        """Yield the rings' messages: `legs`, then `leg`, then `servo`, then resets.

        All rings are read before the first message is handled. A client's reaction to one of these messages is newer
        than all of them, so it belongs to a later instant.
        """
        # Rings with a wakeup are read. After lost wakeups, and after a timer, all are (4 µs): a Stop whose wakeup has
        # not been received yet precedes a frame whose rate slot has come.
        try:
            found = self._rings.read(() if self._read_all else self._woken)
            self.instant_open, self.passed_over = self._rings.instant_open, self._rings.passed_over
        except zenoh.ZError:  # while the inbox closes, a tick may find its rings gone
            found = []
        taken: dict[str, int] = {}
        for key, received in found:
            if received is None:
                yield _lost(key, self._passed_over)
            else:
                taken[key] = taken.get(key, 0) + 1
                yield received
        while self._others:
            yield self._others.popleft()
        if self._woken or self._read_all:
            self._look_for_missed(taken)
        if self.instant_open:
            self._closing.set_in(FLOOD_PAUSE_S)  # to close the instant, if no further message does

    def makes_progress(self) -> bool:
        """Return whether all threads run, and the receiver threads make progress. Call it once a beat, as owner."""
        self.is_quiet = not self._got_wakeup and not any(each.at_work for each in self._receivers)
        self._got_wakeup = False
        self._wake()  # all rings are read: a message may have come before its wakeup, or long after it
        progress = [receiver.makes_progress() for receiver in self._receivers]  # each counts its beats
        return all(progress) and all(worker.runs for worker in self._workers)

    def close(self) -> None:
        """Undeclare everything, which ends the receiver threads, and join them.

        Blocks, so do not call it on the loop's thread.
        """
        for declared in self._declared:
            with suppress(zenoh.ZError):
                declared.undeclare()
        for asked in self._asked.values():
            asked.close()
        for receiver in self._receivers:
            receiver.thread.join()
        for worker in self._workers:
            worker.close()

    def _ring(self, declare: Callable[[str, Any], Any], key: str, depth: int) -> Any:
        declared = declare(key, RingChannel(depth))
        self._declared.append(declared)
        return declared.handler

    # ---- on the receiver threads

    def _note_question(self, key: str, read: Reader, query: zenoh.Query, received_ns: int) -> OwnersTask:
        return read(query, received_ns, _reply_by(self._replies, query, key))

    def _estop(self, item: _Item, received_ns: int) -> OwnersTask:
        if isinstance(item, zenoh.Query) and "*" in str(item.key_expr):
            # A `get` on hexapod/** lists keys and means no stop. A `put` on a wildcard does.
            detail = f"a get by wildcard engages no emergency stop; get or put on {ESTOP}"
            rejection = Ack(accepted=False, reason=Reason.INVALID, detail=detail).model_dump_json().encode()
            return partial(_reply_by(self._estop_replies, item, ESTOP), rejection)
        self.estops.append(_received(self._estop_replies, ESTOP, item, received_ns))
        self._on_estop_received()
        return self._serve_estops

    # ---- as owner of the state

    # mutants accepted (Forget): freed a moment later
    def _on_wakeup(self, item: _Item, received_ns: int) -> float | None:
        self._got_wakeup = True
        self._note(item, received_ns)
        del item
        # The wakeups are emptied before the rings are read, so that a message in between wakes again. Wakeups that
        # arrive during this are left for the next tick.
        for wakeup in self._wakeups:
            count = 0
            try:
                while count < OTHER_DEPTH and (another := wakeup.try_recv()) is not None:
                    self._note(another, received_ns)
                    del another
                    count += 1
            except zenoh.ZError:  # while the inbox closes, a tick may find its rings gone
                pass
            # Two of a full ring's wakeups may have been taken after another was lost: `item`, and the other thread's.
            self._read_all = self._read_all or count >= OTHER_DEPTH - 2
        flooded = self._read_all
        for asked in self._asked.values() if flooded else ():
            asked.wake()
        self._wake()
        return FLOOD_PAUSE_S if flooded else None

    def _note(self, item: _Item, received_ns: int) -> None:
        """Count a wakeup for a command key, and pass on one for a question. Their own rings have the messages.

        Keep a message on an unknown command key.
        """
        key, asks = str(item.key_expr), type(item) is zenoh.Query
        if key in _RING_KEYS:
            self._woken[key] = self._woken.get(key, 0) + 1
        elif key != ESTOP:
            readers = COMMAND_KEYS.keys() | self._asked.keys() if asks else COMMAND_KEYS.keys()
            named = _named(item, readers) if "*" in key else readers & {key}
            for each in named - {ESTOP}:
                if each in self._asked:
                    self._asked[each].wake()
                else:
                    self._woken[each] = self._woken.get(each, 0) + 1
            if not named and _COMMANDS.intersects(zenoh.KeyExpr(key)):
                self._others.append(_received(self._replies, key, item, received_ns))
                return
        if type(item) is zenoh.Query:
            # A client may wait for the ends of all its queries, so an emergency stop's end does not queue with others.
            # Releasing the last reference sends the end, which may block.
            (self._estop_replies if key == ESTOP else self._replies).do(item.drop)

    def _look_for_missed(self, taken: Mapping[str, int]) -> None:
        """Poll all rings a few times more if wakeups were lost, or a key had more wakeups than messages.

        A message may reach its ring after its wakeup. One that was taken before its wakeup costs these polls, too.
        """
        woken, self._woken = self._woken, {}
        if self._read_all:
            self._read_all = False
            self._poll_later(POLL_AFTER_FLOOD)
        elif woken != taken and any(count > taken.get(key, 0) for key, count in woken.items()):
            self._poll_later(0)

    def _poll_later(self, attempt: int) -> None:
        self._attempt = attempt
        if attempt < len(POLL_AGAIN_S):
            self._poll_again.cancel()
            self._poll_again.set_in(POLL_AGAIN_S[attempt])

    def _poll_now(self) -> None:
        attempt = self._attempt + 1
        self._wake()  # without a wakeup, all rings are read
        self._poll_later(attempt)


def _named(item: _Item, among: Collection[str]) -> set[str]:
    return {key for key in among if item.key_expr.intersects(zenoh.KeyExpr(key))}


def _reply_by(sender: Worker, query: zenoh.Query, key: str) -> Reply:
    """Return a function that replies once to this query on `key`, on the sender's thread. The client waits for it."""

    def send(payload: bytes) -> None:
        try:
            with query:  # the client waits as long as a reference to its query exists
                query.reply(key, payload, encoding="application/json")
        except zenoh.ZError as error:
            logger.warning("a reply on %s could not be sent: %s", key, error)

    return lambda payload: sender.do(partial(send, payload))


def _lost(key: str, count: int) -> Received:
    return Received(key, key, COMMAND_KEYS[key], Verb.LOST, b"", count, "zenoh/bytes", None, time.monotonic_ns())


def _received(answers: Worker, key: str, item: _Item, received_ns: int | None = None) -> Received:
    """Return the message that arrived on `key` at `received_ns` (None: now)."""
    payload = item.payload
    size = len(payload) if payload is not None else 0
    if type(item) is zenoh.Query:
        verb, reply = Verb.GET, _reply_by(answers, item, key)
    else:
        verb, reply = (_DELETE if item.kind == _KIND_DELETE else _PUT), None
    return Received(
        key=key,
        expression=str(item.key_expr),
        target=COMMAND_KEYS[key] if key in COMMAND_KEYS else None,  # noqa: SIM401  (a call less, for each message)
        verb=verb,
        payload=payload.to_bytes() if payload is not None and size <= MAX_PAYLOAD_BYTES else b"",
        size=size,
        encoding=str(item.encoding) if item.encoding is not None else "zenoh/bytes",
        source=str(item.source_info.source_id.zid) if item.source_info is not None else None,
        received_ns=time.monotonic_ns() if received_ns is None else received_ns,
        reply=reply,
    )
