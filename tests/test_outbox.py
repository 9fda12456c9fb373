"""The right edge knows whether anybody listens."""

import queue
from contextlib import closing
from typing import Any

from zenoh.handlers import RingChannel

from gateway.outbox import ZenohOutbox
from gateway.settings import ZenohSettings
from gateway.zenoh_setup import client_config, open_session, service_config
from schemas.keys import STATE
from tests.gateway_process import free_port


def test_it_knows_whether_anyone_listens() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    outbox = ZenohOutbox()
    assert not outbox.anyone_listens(STATE)
    with closing(open_session(service_config(ZenohSettings(listen=(endpoint,))))) as session:
        outbox.open(session)
        assert not outbox.anyone_listens(STATE)
        changes: queue.SimpleQueue[Any] = queue.SimpleQueue()
        publisher = session.declare_publisher(STATE)
        listener = publisher.declare_matching_listener(changes.put)
        with closing(open_session(client_config(endpoint))) as laptop:
            for key in (STATE, "hexapod/**"):
                subscriber = laptop.declare_subscriber(key, RingChannel(1))
                assert changes.get(timeout=10).matching
                assert outbox.anyone_listens(STATE)
                subscriber.undeclare()
                assert not changes.get(timeout=10).matching
                assert not outbox.anyone_listens(STATE)
        listener.undeclare()
