"""The first of a laptop's hosts is no way to the robot: a Stop goes by the second one."""

import json
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gateway.client import Client
from tests.support.gateway_process import Gateway, free_port

MOST_S = 9.0
"""Half a second was measured; Zenoh's own patience with a silent host is ten."""


@contextmanager
def no_way(kind: str) -> Iterator[str]:
    """An endpoint that leads nowhere; `silent`: it accepts, and then says nothing."""
    if kind == "rejecting":
        yield f"tcp/127.0.0.1:{free_port()}"
    else:
        with socket.create_server(("127.0.0.1", 0)) as server:
            yield f"tcp/127.0.0.1:{server.getsockname()[1]}"


@pytest.mark.parametrize("kind", ["rejecting", "silent"])
def test_a_stop_goes_by_the_second_host(tmp_path: Path, kind: str) -> None:
    with Gateway(tmp_path) as gateway, no_way(kind) as nowhere:
        hosts = tmp_path / "hosts.json5"
        transport = {"unicast": {"open_timeout": 1000}}
        connect = {"endpoints": [nowhere, gateway.endpoint]}
        hosts.write_text(json.dumps({"mode": "client", "connect": connect, "transport": transport}))
        begun_s = time.monotonic()
        with Client(None, zenoh_config=hosts, timeout_s=10) as client:
            assert client.estop().stop_frames == 6
        assert time.monotonic() - begun_s < MOST_S
