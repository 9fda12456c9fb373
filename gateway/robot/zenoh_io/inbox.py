"""The left edge: Zenoh's subscribers and queryables, a ring for each key, and the threads that wait for them.

Zenoh delivers on threads of its own. A callback per message would cost Python time for each, so that a flood of one key
would delay everything else by seconds. Here each key has a ring in Rust that keeps its newest messages, and one thread
waits on a subscriber that receives them all: the wakeup. It then owns the state (`robot.host.ownership`) for one tick,
in which it takes what the rings hold and writes the frames. So work per tick is bounded, a message that is overwritten
costs nothing, and no other thread has to be woken for a command.

The emergency stop has rings and receiver threads of its own, which no flood of other keys can touch.
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
from zenoh.handlers import Handler, RingChannel

from gateway.host.realtime import LOOP_PRIORITY
from gateway.host.worker import Worker
from gateway.robot.core.intake import words_of_stop
from gateway.robot.core.message import Received, Reply, Verb
from gateway.robot.host.ownership import Ownership, OwnersTimer
from gateway.robot.zenoh_io.questions import QUESTIONS_DEPTH, QuestionRing, TokenCheck
from gateway.robot.zenoh_io.receiver import OwnersTask, Reader, ReceiverThread
from gateway.robot.zenoh_io.rings import LEAST_PUT_DEPTH, RING_DEPTH, Receive, Rings
from schemas.command import MAX_PAYLOAD_BYTES
from schemas.keys import ALL_COMMANDS, COMMAND_KEYS, ESTOP, STATE
from schemas.telemetry import Ack, Reason


class ReplySender(Worker):
    """Sends replies and ends queries in order. Only `close` blocks its caller."""

    def __init__(self, name: str) -> None:
        super().__init__(name, priority=None)

    def to(self, query: zenoh.Query, key: str) -> Reply:
        """A function that replies to this query, once; the client waits until then."""

        def send(payload: bytes) -> None:
            try:
                with query:  # the client waits as long as a reference to its query exists
                    query.reply(key, payload, encoding="application/json")
            except zenoh.ZError as error:
                logger.warning("a reply on %s could not be sent: %s", key, error)

        return lambda payload: self.do(lambda: send(payload))

    def let_go(self, query: zenoh.Query) -> None:
        """Release a query that is answered elsewhere. Releasing the last reference sends its end, which may block."""
        self.do(query.drop)


OTHER_DEPTH: Final = 16
"""The same for what names no key of ours; it is rejected one by one, so there is no use in more."""
READER_DEPTH: Final = 32
"""Questions on a further key that wait to be read. One that is pushed out has no answer, which its sender notices."""
LOOK_AGAIN_S: Final = (0.0002, 0.001, 0.004, 0.016, 0.064)
"""The wakeup can ring before the message has reached its key's own ring (two deliveries, one after the other, by a
thread that may be interrupted in between). So a wakeup whose key had nothing is followed by some more looks."""
LOOK_AFTER_FLOOD: Final = 2
"""The first of these looks after wakeups were lost: later than the next tick of a flood, which looks anyway."""
_EARLY_S: Final = sum(LOOK_AGAIN_S)
"""For how long a message's wakeup is expected after the message itself was taken."""

FLOOD_PAUSE_S: Final = 0.001
"""How long a wakeup does not ring after a tick that found it full. Without it, ticks follow one another without a
pause, and take the processor from the threads of Zenoh's that receive: what is in their sockets then grows old. A
flooded leg's frames, p99, on a busy machine: 171 and 181 ms without the pause, 25 and 50 ms with it."""

_Item = zenoh.Sample | zenoh.Query
_PUT, _DELETE, _LOST, _KIND_DELETE = Verb.PUT, Verb.DELETE, Verb.LOST, zenoh.SampleKind.DELETE
"""Each message asks for these; see `frames.OP_STOP`."""
_RING_KEYS: Final = COMMAND_KEYS.keys() - {ESTOP}

logger = logging.getLogger(__name__)


class Inbox:
    """Everything that comes in. Its callbacks are called by an owner of the state, and so is `take`."""

    def __init__(
        self,
        session: zenoh.Session,
        loop: asyncio.AbstractEventLoop,
        owner: Ownership,
        *,
        on_wakeup: Callable[[], None],
        on_estop: Callable[[], None],
        on_state_query: Callable[[Reply], None],
        readers: Mapping[str, Reader] = MappingProxyType({}),
        tokens: Mapping[str, TokenCheck] = MappingProxyType({}),
        depth: int = LEAST_PUT_DEPTH,
        on_estop_received: Callable[[], None] | None = None,
    ) -> None:
        """`on_wakeup`: there is something to `take`. `on_estop`: there is an emergency stop in `estops`.

        `on_estop_received` is called on the thread that has received one, which does not own the state: a transfer that
        hangs may hold that, and the second way to stop must not wait for it.

        `readers` read what is asked on further keys, each on a thread of its own that owns nothing yet; on those in
        `tokens`, questions with a good token are read first. `depth`: how many puts of a key are kept (`put_depth`).
        """
        self._loop = loop
        self._passed_over = depth - RING_DEPTH  # of a full ring
        self._wake = on_wakeup
        self._serve_estops = on_estop
        self._on_estop_received = on_estop_received
        self.estops: deque[Received] = deque()
        self._others: deque[Received] = deque()
        self._woken: dict[str, int] = {}
        """How many messages of each key there are, by the wakeups since the last tick."""
        self._missed: dict[str, int] = {}
        """How many of them woke the inbox before that, and have not been taken yet."""
        self._early: dict[str, int] = {}
        """How many were taken before their wakeup arrived."""
        self._early_until_s = 0.0
        self._lost_some = False  # wakeups, so that nobody knows for which keys to look again
        self._look_at: Collection[str] = ()
        self._read_all = False
        self._look_again = OwnersTimer(loop, owner, self._look_now)
        self._attempt = 0
        self.instant_open = False
        """Whether what is taken next is of the same instant as what was taken last."""
        self._closing = OwnersTimer(loop, owner, on_wakeup)
        self._declared: list[Any] = []
        self._replies = ReplySender("answers")
        self._estop_replies = ReplySender("estop-answers")  # nobody else's answers are waited for

        receivers: dict[str, tuple[Receive[_Item], Receive[_Item]]] = {
            key: (
                self._subscriber(session, key, depth).try_recv,
                self._queryable(session, key, RING_DEPTH).try_recv,
            )
            for key in COMMAND_KEYS
            if key != ESTOP
        }
        self._rings = Rings[_Item, Received](receivers, partial(_received, self._replies), words_of_stop, depth)
        self._wakeups = (
            self._subscriber(session, ALL_COMMANDS, OTHER_DEPTH),
            self._queryable(session, ALL_COMMANDS, OTHER_DEPTH),
        )
        estops = (
            ("estop-put", self._subscriber(session, ESTOP, 1)),
            ("estop-get", self._queryable(session, ESTOP, RING_DEPTH)),
        )
        waits: list[tuple[str, Handler[Any] | QuestionRing, Callable[[Any, int], OwnersTask]]] = [
            ("wakeup-put", self._wakeups[0], partial(partial, self._on_wakeup)),
            ("wakeup-get", self._wakeups[1], partial(partial, self._on_wakeup)),
            (
                "state-get",
                self._queryable(session, STATE, RING_DEPTH),
                lambda query, _: partial(on_state_query, self._replies.to(query, STATE)),
            ),
        ]
        self._read_elsewhere = readers.keys()
        self._question_rings: list[QuestionRing] = []
        for key, read in readers.items():
            ring = self._queryable(session, key, QUESTIONS_DEPTH if key in tokens else READER_DEPTH)
            waits.append((f"{key}-get", self._sorted(ring, tokens.get(key)), self._note_for(key, read)))
        self._receivers = [
            *(ReceiverThread(name, ring, loop, owner, self._estop, priority=LOOP_PRIORITY) for name, ring in estops),
            *(ReceiverThread(name, ring, loop, owner, note) for name, ring, note in waits),
        ]
        self._threads = [receiver.thread for receiver in self._receivers]
        self._threads += [self._replies.thread, self._estop_replies.thread]

    def take(self) -> Iterator[Received]:
        """What the rings hold: `legs`, then `leg`, then `servo`, then resets.

        The rings are read before the first message is dealt with: what is sent in answer to one of these messages is
        newer than all of them, and belongs to a later instant.
        """
        # Those whose wakeup came. All, where wakeups may have been lost, and where a timer woke the loop: a Stop whose
        # wakeup has not been noted yet goes before a frame whose rate slot has come. To look into all takes 4 µs.
        keys = () if self._read_all else {*self._woken, *self._look_at}
        try:
            found = self._rings.read(keys)
        except zenoh.ZError:  # while the inbox closes, a tick may find its rings gone
            found = []
        self.instant_open = self._rings.instant_open
        if self._others:
            found += [(other.key, other) for other in self._others]
            self._others.clear()
        taken: dict[str, int] = {}
        for key, each in found:
            received = _lost(key, self._passed_over) if each is None else each
            if received.target is not None and received.verb is not _LOST:
                taken[received.key] = taken[received.key] + 1 if received.key in taken else 1
            yield received
        self._compare(taken)
        self._read_all = False
        if self.instant_open:
            self._closing.set_in(FLOOD_PAUSE_S)  # to close it, if nothing else comes

    @property
    def receives(self) -> bool:
        """Whether all receiver threads live; without them no command, and no emergency stop, would be noticed."""
        return all(thread.is_alive() for thread in self._threads)

    def makes_progress(self) -> bool:
        """Whether no receiver thread is stuck with an item. To be asked at each beat of the loop."""
        return not [receiver for receiver in self._receivers if not receiver.makes_progress()]  # each of them is asked

    def close(self) -> None:
        """Undeclare everything, which ends the receiver threads, and join them. Blocks; not for the loop's thread."""
        for declared in self._declared:
            with suppress(zenoh.ZError):
                declared.undeclare()
        for receiver in self._receivers:
            receiver.thread.join()
        for answers in (self._replies, self._estop_replies):
            answers.close()
        for ring in self._question_rings:
            ring.close()

    def _subscriber(self, session: zenoh.Session, key: str, depth: int) -> Handler[zenoh.Sample]:
        subscriber = session.declare_subscriber(key, RingChannel(depth))
        self._declared.append(subscriber)
        return subscriber.handler

    def _queryable(self, session: zenoh.Session, key: str, depth: int) -> Handler[zenoh.Query]:
        queryable = session.declare_queryable(key, RingChannel(depth))
        self._declared.append(queryable)
        return queryable.handler

    def _sorted(self, ring: Handler[zenoh.Query], knows: TokenCheck | None) -> Handler[zenoh.Query] | QuestionRing:
        if knows is None:
            return ring
        self._question_rings.append(QuestionRing(ring, knows, time.monotonic_ns))
        return self._question_rings[-1]

    # ---- on the receiver threads

    def _note_for(self, key: str, read: Reader) -> Callable[[zenoh.Query, int], OwnersTask]:
        return lambda query, received_ns: read(query, received_ns, self._replies.to(query, key))

    def _estop(self, item: _Item, received_ns: int) -> OwnersTask:
        if isinstance(item, zenoh.Query) and "*" in str(item.key_expr):
            # Who lists what there is (`get` on hexapod/**) wants to see, not to stop. A put is meant, and a Stop.
            return partial(self._estop_replies.to(item, ESTOP), _NOT_BY_WILDCARD)
        self.estops.append(_received(self._estop_replies, ESTOP, item, received_ns))
        if self._on_estop_received is not None:
            self._on_estop_received()
        return self._serve_estops

    # ---- as owner of the state

    def _on_wakeup(self, item: _Item, received_ns: int) -> float | None:
        self._note(item, received_ns)
        del item
        # The wakeups are emptied before the rings are read: a message that comes in between wakes again. What comes
        # while they are emptied is left for the next time.
        for wakeup in self._wakeups:
            count = 0
            try:
                while count < OTHER_DEPTH and (another := wakeup.try_recv()) is not None:
                    self._note(another, received_ns)
                    del another
                    count += 1
            except zenoh.ZError:  # while the inbox closes, a tick may find its rings gone
                pass
            # Of a full wakeup two may have been taken out after another was lost: this one, and its thread's.
            self._read_all = self._read_all or count >= OTHER_DEPTH - 2
        flooded = self._read_all
        self._wake()
        return FLOOD_PAUSE_S if flooded else None

    def _note(self, item: _Item, received_ns: int) -> None:
        """A key of ours is read from its own ring; what names none of ours is rejected from here."""
        key = str(item.key_expr)
        if key in _RING_KEYS:
            self._woken[key] = self._woken[key] + 1 if key in self._woken else 1
        elif key != ESTOP and not (key in self._read_elsewhere and isinstance(item, zenoh.Query)):
            wild = "*" in key
            named = _named(item, COMMAND_KEYS) if wild else set[str]()
            for each in named & _RING_KEYS:
                self._woken[each] = self._woken.get(each, 0) + 1
            if not named and not (wild and isinstance(item, zenoh.Query) and _named(item, self._read_elsewhere)):
                self._others.append(_received(self._replies, key, item, received_ns))
                return
        if type(item) is zenoh.Query:
            # Its asker may wait for the end of all that it reached, so an emergency stop's is not sent behind others.
            (self._estop_replies if key == ESTOP else self._replies).let_go(item)

    def _compare(self, taken: dict[str, int]) -> None:
        """Look again, if more wakeups came than messages were taken: one of them has not reached its key's ring yet.

        They are counted, since another message of the same key may have been taken in its place.
        """
        woken, self._woken = self._woken, {}
        if self._read_all:
            self._missed, self._early, self._lost_some = {}, {}, True
            self._look_later(LOOK_AFTER_FLOOD)
        elif taken != woken or self._early:
            counts = (self._missed, woken, self._early, taken)
            left = {
                key: self._missed.get(key, 0) + woken.get(key, 0) - self._early.get(key, 0) - taken.get(key, 0)
                for count in counts
                for key in count
            }
            missed_more = any(count > self._missed.get(key, 0) for key, count in left.items())
            self._missed = {key: count for key, count in left.items() if count > 0}
            if not self._early:
                self._early_until_s = self._loop.time() + _EARLY_S
            # No message may be forgotten for ever, because another was counted once too often.
            late = self._loop.time() > self._early_until_s
            self._early = {} if late else {key: -count for key, count in left.items() if count < 0}
            if missed_more:
                self._look_later(0)

    def _look_later(self, attempt: int) -> None:
        self._look_again.cancel()
        if self._missed or self._lost_some:
            self._attempt = attempt
            self._look_again.set_in(LOOK_AGAIN_S[attempt])

    def _look_now(self) -> None:
        attempt = self._attempt
        self._look_at = () if self._lost_some else tuple(self._missed)
        self._wake()
        self._look_at = ()
        if attempt + 1 < len(LOOK_AGAIN_S):
            self._look_later(attempt + 1)
        else:
            self._missed, self._lost_some = {}, False  # pushed out of its ring, or taken before its wakeup arrived


_NOT_BY_WILDCARD: Final = (
    Ack(
        accepted=False,
        reason=Reason.INVALID,
        detail=f"a get by wildcard engages no emergency stop; get or put on {ESTOP}",
    )
    .model_dump_json()
    .encode()
)


def _named(item: _Item, among: Collection[str]) -> set[str]:
    """The keys that a wildcard names."""
    return {key for key in among if item.key_expr.intersects(zenoh.KeyExpr(key))}


def _lost(key: str, count: int) -> Received:
    return Received(key, key, COMMAND_KEYS[key], Verb.LOST, b"", count, "zenoh/bytes", None, time.monotonic_ns())


def _received(answers: ReplySender, key: str, item: _Item, received_ns: int | None = None) -> Received:
    """What arrived on `key`, and when it came, where that is known better than by now."""
    payload = item.payload
    size = len(payload) if payload is not None else 0
    if type(item) is zenoh.Query:
        verb, reply = Verb.GET, answers.to(item, key)
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
