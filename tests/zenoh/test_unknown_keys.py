"""A message on a key that nothing reads gets an event that names the nearest one."""

import json
import time
from pathlib import Path

import zenoh

from schemas.telemetry import Kind
from tests.support.gateway_process import Gateway
from tests.support.heard import events

START = json.dumps({"servos": [{"op": "start", "angle_deg": 90}] * 3})


def test_a_flood_beside_the_keys_is_told_ten_times_a_second_and_a_command_goes_through(tmp_path: Path) -> None:
    with Gateway(tmp_path) as gateway, gateway.client() as client:
        heard = events(client)
        client.state()
        publisher = client.session.declare_publisher(
            "hexapod/leg/3/set", congestion_control=zenoh.CongestionControl.DROP
        )
        begun = time.monotonic()
        for _ in range(5000):
            publisher.put(START)
        assert heard.wait(lambda event: event.kind is Kind.COMMAND_REJECTED)
        assert client.start_leg(3, 90, 45, 120).accepted
        assert client.state().commands.rejected <= 2 + 10 * (time.monotonic() - begun)
