"""The ROS side: one node of the graph over one Zenoh session, its publishers, subscribers and services.

What comes in waits in rings that keep the newest, and a thread for each reads them: a flood on one topic costs what it
overwrites, and nobody else anything.
"""

import itertools
import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

import zenoh
from zenoh import ext
from zenoh.handlers import RingChannel

from gateway.errors import ConfigError, GatewayError, ZenohError
from gateway.people.client.blocking import Client
from gateway.people.ros2.cdr import Message, encode
from gateway.people.ros2.messages import TRIGGER_HASH, TRIGGER_TYPE, TriggerResponse
from gateway.people.ros2.wire import (
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

JOIN_S: Final = 1.0
_QUERIES: Final = 16
"""Calls of one service that wait; of more, the oldest have no answer. An emergency stop is engaged all the same."""
_APART_S: Final = 1.0
_NO_ROS_PEER: Final = (
    ", where no ROS peer should be: --router names ROS 2's own router. Where both are on one machine, the gateway "
    'needs another port, such as zenoh.listen = ["tcp/127.0.0.1:7448"]'
)
_NOBODY: Final = bytes(16)

_log: Final = logging.getLogger(__name__)


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


def check_apart(router: zenoh.Session, client: Client) -> None:
    """Raises ConfigError where ROS peers reach the gateway itself.

    Its Zenoh id decides, which no ROS peer knows: anybody can declare the token of a gateway.
    """
    client.state()
    gateway = client.answerers(STATE)
    replies: Any = router.get(f"**/{STATE}", timeout=_APART_S, target=zenoh.QueryTarget.ALL)
    there = {str(reply.replier_id.zid) for reply in replies if reply.replier_id is not None}
    same = {str(zid) for zid in router.info.routers_zid()} & {str(zid) for zid in client.session.info.routers_zid()}
    if same or gateway & there:
        raise ConfigError(f"--router leads to the gateway{_NO_ROS_PEER}")


class Publisher:
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


class Node:
    """One node, until `close`."""

    def __init__(self, session: zenoh.Session, names: Names) -> None:
        self.names = names
        self._session = session
        self._zid = str(session.info.zid())
        self._numbers = itertools.count(1)
        self._declared: list[Any] = [session.liveliness().declare_token(names.node_token(self._zid))]
        self._threads: list[threading.Thread] = []

    def publisher(self, topic: str, kind: type[Message], *, latched: bool = False) -> Publisher:
        """A topic of ours; `latched`: who comes later is given the last message."""
        token = self._show(PUBLISHES, topic, kind.TYPE, kind.HASH, QOS_LATCHED if latched else QOS)
        key = self.names.topic_key(topic, kind)
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
        return Publisher(found, gid_of(token))

    def subscribe(self, topic: str, kind: type[Message], take: Callable[[zenoh.Sample], None]) -> None:
        """A topic that comes in, whichever type its publishers take it for: `take` gets the newest, on a thread."""
        self._show(SUBSCRIBES, topic, kind.TYPE, kind.HASH, QOS)
        self._listen(self.names.any_type(topic), topic, take)

    def serve(self, service: str, call: Callable[[], str], *, always: bool = False) -> None:
        """A std_srvs/Trigger; `call` returns what it did, or raises GatewayError, on a thread.

        `always`: any call is taken, whatever its type and hash and without an attachment, and any message on a topic of
        that name, too.
        """
        self._show(SERVES, service, TRIGGER_TYPE, TRIGGER_HASH, QOS)
        exact = self.names.key(service, TRIGGER_TYPE, TRIGGER_HASH)
        key = self.names.any_type(service) if always else exact
        queryable: Any = self._session.declare_queryable(key, RingChannel(_QUERIES), complete=True)
        self._declared.append(queryable)
        self._start(f"serve {service}", queryable.handler, lambda query: _answer(query, call, always=always))
        if always:
            self._listen(key, service, lambda _: _try(call))

    def close(self) -> None:
        """Undeclare all, and wait for the threads."""
        for each in self._declared:
            with suppress(zenoh.ZError):
                each.undeclare()
        for thread in self._threads:
            thread.join(JOIN_S)

    def _listen(self, key: str, name: str, take: Callable[[zenoh.Sample], object]) -> None:
        subscriber: Any = self._session.declare_subscriber(key, RingChannel(1))
        self._declared.append(subscriber)
        self._start(f"receive {name}", subscriber.handler, take)

    def _start(self, name: str, handler: Any, take: Callable[[Any], object]) -> None:
        thread = threading.Thread(target=_read, args=(handler, take), name=name, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _show(self, kind: str, name: str, type_name: str, type_hash: str, qos: str) -> str:
        token = self.names.token(self._zid, next(self._numbers), kind, name, type_name, type_hash, qos)
        self._declared.append(self._session.liveliness().declare_token(token))
        return token


class Senders:
    """Who publishes on a topic now, by the tokens of the graph."""

    def __init__(self, session: zenoh.Session, names: Names, topic: str) -> None:
        self._tokens: dict[str, bytes] = {}
        self._subscriber: Any = session.liveliness().declare_subscriber(
            names.publishers(topic), self._change, history=True
        )

    def watch(self, gid: bytes) -> Callable[[], bool]:
        """Tells whether this sender is still there; of one that shows no token of its own, whether all are."""
        if gid in self._tokens.values():
            return lambda: gid in self._tokens.values()
        present = self._tokens.keys()
        return lambda: bool(present) and present <= self._tokens.keys()

    def close(self) -> None:
        """End the subscriptions and the thread."""
        with suppress(zenoh.ZError):
            self._subscriber.undeclare()

    def _change(self, sample: zenoh.Sample) -> None:
        token = str(sample.key_expr)
        tokens = {**self._tokens, token: gid_of(token)}
        if sample.kind == zenoh.SampleKind.DELETE:
            del tokens[token]
        self._tokens = tokens  # replaced, never changed: others read it


def _read(handler: Any, take: Callable[[Any], object]) -> None:
    for each in handler:
        try:
            take(each)
        except Exception:
            _log.exception("a message could not be handled")


def _answer(query: zenoh.Query, call: Callable[[], str], *, always: bool) -> None:
    if "*" in str(query.key_expr):  # whoever lists what there is calls nothing
        query.drop()
        return
    attachment = query.attachment
    try:
        asked = Attachment.from_bytes(attachment.to_bytes() if attachment is not None else None)
    except WireError as error:
        if not always:
            with query:
                query.reply_err(str(error))
            return
        asked = Attachment(0, time.time_ns(), _NOBODY)
    response = _try(call)
    answer = Attachment(asked.number, time.time_ns(), asked.gid)
    with suppress(zenoh.ZError), query:
        query.reply(query.key_expr, encode(response), attachment=answer.to_bytes())


def _try(call: Callable[[], str]) -> TriggerResponse:
    try:
        return TriggerResponse(True, call())
    except GatewayError as error:
        return TriggerResponse(False, str(error).replace("\0", "�"))
