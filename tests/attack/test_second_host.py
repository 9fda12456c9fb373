"""The first of a laptop's hosts is no way to the robot: a Stop goes by the second one."""

import json
import socket
import time
from pathlib import Path

import pytest

from gateway.client import Client
from tests.support.gateway_process import Gateway

MOST_S = 9.0
"""Half a second was measured; Zenoh's own patience with a silent host is ten."""


@pytest.mark.parametrize("silent", [False, True])
def test_a_stop_goes_by_the_second_host(tmp_path: Path, silent: bool) -> None:
    """The first rejects connections, or accepts them and then says nothing."""
    with Gateway(tmp_path) as gateway, socket.socket() as first:
        first.bind(("127.0.0.1", 0))
        if silent:
            first.listen()
        nowhere = f"tcp/127.0.0.1:{first.getsockname()[1]}"
        hosts = tmp_path / "hosts.json5"
        transport = {"unicast": {"open_timeout": 1000}}
        connect = {"endpoints": [nowhere, gateway.endpoint]}
        hosts.write_text(json.dumps({"mode": "client", "connect": connect, "transport": transport}))
        begun_s = time.monotonic()
        with Client(None, zenoh_config=hosts, timeout_s=10) as client:
            assert client.estop().stop_frames == 6
        assert time.monotonic() - begun_s < MOST_S
