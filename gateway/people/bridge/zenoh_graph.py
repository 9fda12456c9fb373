"""A ROS 2 graph over one Zenoh session, as rmw_zenoh speaks, without ROS.

Received messages wait in rings that keep the newest, and each ring has a thread that reads it: so a flood on one topic
delays no other.
"""

import itertools
import threading
import time
from collections.abc import Callable, Set
from contextlib import suppress
from typing import Any, Final

import zenoh
from zenoh import ext
from zenoh.handlers import RingChannel

from gateway.errors import ConfigError, ZenohError
from gateway.people.bridge.graph import JOIN_S, Arrived, Present, Respond, Take, attempt, read_each, too_long
from gateway.people.bridge.parameters import Parameters
from gateway.people.bridge.router_access import check_closed
from gateway.people.client.blocking import Client
from gateway.people.client.requests import Identity
from gateway.people.ros2.cdr import Message, encode
from gateway.people.ros2.messages import TRIGGER_HASH, TRIGGER_TYPE
from gateway.people.ros2.wire import (
    CALLS,
    PUBLISHES,
    QOS,
    QOS_LATCHED,
    SERVES,
    SUBSCRIBES,
    Attachment,
    Names,
    WireError,
    gid_of,
)
from gateway.zenoh_config import connect_endpoints, one_line
from schemas.keys import STATE

_QUERIES: Final = 16
"""Calls of one service that wait; of more, the oldest have no answer. An emergency stop is engaged all the same."""
_APART_S: Final = 1.0
_NO_ROS_PEER: Final = (
    ", where no ROS peer should be: --router names ROS 2's own router. Where both are on one machine, the gateway "
    'needs another port, such as zenoh.listen = ["tcp/127.0.0.1:7448"]'
)
_NOBODY: Final = bytes(16)


def open_router(config: zenoh.Config) -> zenoh.Session:
    """A session to ROS 2's router, which comes back by itself. Raises ConfigError, ZenohError."""
    endpoint = ", ".join(connect_endpoints(config))
    config.insert_json5("timestamping/enabled", "true")  # the cache of a latched topic wants it; so has rmw_zenoh
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise ZenohError(
            f"no ROS 2 router answers on {endpoint} ({one_line(error)}); `ros2 run rmw_zenoh_cpp rmw_zenohd` starts one"
        ) from error
    if not session.info.routers_zid():
        session.close()
        raise ConfigError(f"{endpoint} leads to no router{_NO_ROS_PEER}")
    return session


class ZenohPublisher:
    """Puts messages of one topic; for one thread."""

    def __init__(self, publisher: Any, gid: bytes) -> None:
        self._publisher = publisher
        self._gid = gid
        self._numbers = itertools.count(1)

    def publish(self, message: Message) -> None:
        """Fire and forget. While the router is away it is lost."""
        attachment = Attachment(next(self._numbers), time.time_ns(), self._gid)
        with suppress(zenoh.ZError):
            self._publisher.put(encode(message), attachment=attachment.to_bytes())


class ZenohGraph:
    """See Graph. Closes the session, too."""

    def __init__(self, config: zenoh.Config, session: zenoh.Session, names: Names) -> None:
        self.where = ", ".join(connect_endpoints(config))
        self._names = names
        self._config = config
        self._session = session
        self._zid = str(session.info.zid())
        self._numbers = itertools.count(1)
        self._declared: list[Any] = [session.liveliness().declare_token(names.node_token(self._zid))]
        self._threads: list[threading.Thread] = []

    def check_closed(self) -> None:
        """See Graph: who reaches ROS 2's router."""
        for endpoint in connect_endpoints(self._config):
            check_closed(endpoint, self._session, Identity.of(self._config))

    def check_apart(self, client: Client) -> None:
        """See Graph. The gateway's Zenoh id decides, which no ROS peer knows: anybody can declare its token."""
        client.state()
        gateway = client.answerers(STATE)
        replies: Any = self._session.get(f"**/{STATE}", timeout=_APART_S, target=zenoh.QueryTarget.ALL)
        there = {str(reply.replier_id.zid) for reply in replies if reply.replier_id is not None}
        ours, theirs = self._session.info.routers_zid(), client.session.info.routers_zid()
        if {str(zid) for zid in ours} & {str(zid) for zid in theirs} or gateway & there:
            raise ConfigError(f"--router leads to the gateway{_NO_ROS_PEER}")

    def parameters(self, given: Parameters) -> Parameters:
        """See Graph: parameters are services of a ROS node, which this has not."""
        return given

    def manage(self, activate: Callable[[], None], deactivate: Callable[[str], None]) -> None:
        """See Graph: no lifecycle."""
        del deactivate
        activate()

    def publisher(
        self, topic: str, kind: type[Message], *, latched: bool = False, always: bool = False
    ) -> ZenohPublisher:
        """See Graph."""
        del always
        token = self._show(PUBLISHES, topic, kind.TYPE, kind.HASH, QOS_LATCHED if latched else QOS)
        key = self._names.topic_key(topic, kind)
        drop = zenoh.CongestionControl.DROP
        if latched:
            found: Any = ext.declare_advanced_publisher(
                self._session,
                key,
                congestion_control=drop,
                cache=ext.CacheConfig(max_samples=1),
                publisher_detection=True,
            )
        else:
            found = self._session.declare_publisher(key, congestion_control=drop)
        self._declared.append(found)
        return ZenohPublisher(found, gid_of(token))

    def subscribe(
        self, topic: str, kinds: tuple[type[Message], ...], most_bytes: int, take: Take, reject: Callable[[str], None]
    ) -> None:
        """See Graph. Messages of any type arrive, so that one of another type, or hash, is rejected in words."""
        by_key = {self._names.topic_key(topic, kind): kind for kind in kinds}

        def received(sample: zenoh.Sample) -> None:
            key, attachment = str(sample.key_expr), sample.attachment
            try:
                if key not in by_key:
                    raise WireError(self._other_type(key, kinds[0]))
                if len(sample.payload) > most_bytes:
                    raise WireError(too_long(len(sample.payload), most_bytes))
                sent = Attachment.from_bytes(None if attachment is None else attachment.to_bytes())
            except WireError as error:
                reject(str(error))
            else:
                take(by_key[key], Arrived(sample.payload.to_bytes(), sent.gid, sent.time_ns))

        self._show(SUBSCRIBES, topic, kinds[0].TYPE, kinds[0].HASH, QOS)
        self._listen(self._names.any_type(topic), topic, received)

    def serve(self, service: str, call: Callable[[], str], *, always: bool = False) -> None:
        """See Graph. `always`: any request is taken, whatever its type and hash and without an attachment."""
        self._show(SERVES, service, TRIGGER_TYPE, TRIGGER_HASH, QOS)
        exact = self._names.key(service, TRIGGER_TYPE, TRIGGER_HASH)
        key = self._names.any_type(service) if always else exact
        self._queries(service, key, lambda query: _answer(query, call, always=always))
        if always:
            self._listen(key, service, lambda _: attempt(call))

    def respond(self, service: str, kind: tuple[str, str], most_bytes: int, respond: Respond) -> None:
        """See Graph."""
        self._show(SERVES, service, *kind, QOS)
        self._queries(service, self._names.key(service, *kind), lambda query: _respond(query, most_bytes, respond))

    def senders(self, topic: str) -> Present:
        """See Graph: by the tokens of the graph."""
        return self._present(PUBLISHES, topic)

    def callers(self, service: str) -> Present:
        """See Graph."""
        return self._present(CALLS, service)

    def close(self) -> None:
        """See Graph."""
        declared, self._declared = self._declared, []
        for each in declared:
            with suppress(zenoh.ZError):
                each.undeclare()
        for thread in self._threads:
            thread.join(JOIN_S)
        self._session.close()

    def _other_type(self, key: str, kind: type[Message]) -> str:
        *_, type_name, type_hash = key.split("/")
        *_, wanted_name, wanted_hash = self._names.topic_key("", kind).split("/")
        if type_name != wanted_name:
            return f"it is a {type_name[:80]}, and this topic has {kind.TYPE}"
        return f"its {kind.TYPE} has the hash {type_hash[:20]}…, and ours {wanted_hash[:20]}…: another distribution?"

    def _present(self, kind: str, name: str) -> Present:
        senders = _Senders()
        found: Any = self._session.liveliness().declare_subscriber(
            self._names.tokens(kind, name), senders.change, history=True
        )
        self._declared.append(found)
        return senders.present

    def _queries(self, service: str, key: str, take: Callable[[zenoh.Query], object]) -> None:
        queryable: Any = self._session.declare_queryable(key, RingChannel(_QUERIES), complete=True)
        self._declared.append(queryable)

        def take_exact(query: zenoh.Query) -> None:
            if "*" in str(query.key_expr):  # a listing of all keys calls nothing
                query.drop()
            else:
                take(query)

        self._start(f"serve {service}", queryable.handler, take_exact)

    def _listen(self, key: str, name: str, take: Callable[[zenoh.Sample], object]) -> None:
        subscriber: Any = self._session.declare_subscriber(key, RingChannel(1))
        self._declared.append(subscriber)
        self._start(f"receive {name}", subscriber.handler, take)

    def _start(self, name: str, handler: Any, take: Callable[[Any], object]) -> None:
        thread = threading.Thread(target=read_each, args=(handler, take), name=name, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _show(self, kind: str, name: str, type_name: str, type_hash: str, qos: str) -> str:
        token = self._names.token(self._zid, next(self._numbers), kind, name, type_name, type_hash, qos)
        self._declared.append(self._session.liveliness().declare_token(token))
        return token


class _Senders:
    """Who publishes on a topic, or may call a service, now."""

    def __init__(self) -> None:
        self._tokens: dict[str, bytes] = {}

    def present(self) -> Set[bytes]:
        """The GIDs of their tokens."""
        return frozenset(self._tokens.values())

    def change(self, sample: zenoh.Sample) -> None:
        """A token came, or went."""
        token = str(sample.key_expr)
        tokens = {**self._tokens, token: gid_of(token)}
        if sample.kind == zenoh.SampleKind.DELETE:
            del tokens[token]
        self._tokens = tokens  # replaced, never changed: others read it


def _answer(query: zenoh.Query, call: Callable[[], str], *, always: bool) -> None:
    try:
        asked = _asked(query)
    except WireError as error:
        if not always:
            _reject(query, error)
            return
        asked = Attachment(0, time.time_ns(), _NOBODY)
    _reply(query, asked, attempt(call))


def _respond(query: zenoh.Query, most_bytes: int, respond: Respond) -> None:
    payload = query.payload or zenoh.ZBytes(b"")
    try:
        asked = _asked(query)
        if len(payload) > most_bytes:
            raise WireError(too_long(len(payload), most_bytes))
    except WireError as error:
        _reject(query, error)
        return
    respond(Arrived(payload.to_bytes(), asked.gid, asked.time_ns), lambda response: _reply(query, asked, response))


def _asked(query: zenoh.Query) -> Attachment:
    return Attachment.from_bytes(query.attachment.to_bytes() if query.attachment is not None else None)


def _reject(query: zenoh.Query, error: WireError) -> None:
    with suppress(zenoh.ZError), query:
        query.reply_err(str(error))


def _reply(query: zenoh.Query, asked: Attachment, response: Message) -> None:
    answer = Attachment(asked.number, time.time_ns(), asked.gid)
    with suppress(zenoh.ZError), query:
        query.reply(query.key_expr, encode(response), attachment=answer.to_bytes())
