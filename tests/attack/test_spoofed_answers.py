"""Without access control: programs that answer besides the gateway, with nonsense or to be believed."""

import json
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
import zenoh

from gateway.client import Client
from gateway.zenoh.config import client_config, open_session
from schemas import keys
from schemas.words import Mode
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import Gateway, dialling, free_port

FALSE = '{"accepted": true, "stop_frames": 6, "latency_us": 1}'
NONSENSE = ["{}", "nonsense", '{"accepted": true}', '{"accepted": true, "stop_frames": 6}', "[]", ""]
TIMES = 20
"""Who is first is a matter of luck; with so many questions, the stranger once was in each trial."""


def router_at(endpoint: str) -> zenoh.Session:
    """Return a program in this process that listens there for a gateway that dials."""
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


@contextmanager
def answering(endpoint: str, text: str, *wanted: str) -> Iterator[None]:
    """Yield a stranger's session that answers these keys with `text`."""
    asked = threading.Event()

    def on_query(query: zenoh.Query) -> None:
        asked.set()
        with query:
            query.reply(query.key_expr, text)

    with closing(open_session(client_config(endpoint))) as session, Client(endpoint) as client:
        for key in wanted:
            session.declare_queryable(key, on_query, complete=True)
            asked.clear()
            while not asked.wait(0.01):  # the declaration is on its way
                client.session.get(key, zenoh.handlers.RingChannel(1), timeout=1.0)
        yield


gateway = gateway_fixture()


@pytest.mark.parametrize("text", [*NONSENSE, FALSE])
def test_the_answer_is_the_gateways(gateway: Gateway, text: str) -> None:
    """Also where another's would be believable: the gateway is the program that was dialled."""
    with (
        answering(gateway.endpoint, text, keys.ESTOP, keys.STATE, keys.CONFIG, keys.LEGS_COMMAND),
        gateway.client() as client,
    ):
        for _ in range(TIMES):
            ack = client.estop()
            assert (ack.stop_frames, ack.latency_us == 1) == (6, False)
            assert client.state().spi.frames > 0
            assert client.stop().reason == "estopped"
        assert len(client.answerers(keys.ESTOP, wait_s=5)) == 2


@pytest.mark.parametrize("text", [FALSE, "{}", '{"accepted": true}'])
def test_who_claims_to_be_complete_does_not_take_the_stop_away(tmp_path: Path, text: str) -> None:
    """Zenoh's default asks a complete queryable alone, so a gateway that is a router's client would hear nothing."""
    router = f"tcp/127.0.0.1:{free_port()}"
    settings = {"zenoh": {"config": dialling(tmp_path, router, mode="client")}}
    with (
        router_at(router),
        Gateway(tmp_path, settings),
        answering(router, text, keys.ESTOP),
        Client(router, timeout_s=20) as client,
    ):
        assert client.reset().accepted
        for _ in range(TIMES):
            assert client.estop().stop_frames == 6
        assert len(client.answerers(keys.ESTOP, wait_s=10)) == 2
        assert client.state().mode is Mode.ESTOPPED
