"""A Stop that is put on a key that somebody floods is not lost, although the flood pushes it out of the key's ring."""

import json
from pathlib import Path
from typing import Any

import pytest

from gateway.client import leg_payload
from schemas.keys import leg_command
from tests.benchmarks.processes import flooding
from tests.support.gateway_process import Gateway

SETTINGS: dict[str, dict[str, Any]] = {"watchdog": {"timeout_ms": 10_000}}
TRIES = 200
KEY = leg_command(3)


@pytest.mark.parametrize("flood", [json.dumps(leg_payload("set", (1, 2, 3))), "{ not JSON"])
def test_a_stop_under_a_flood_of_its_own_key_stops(tmp_path: Path, flood: str) -> None:
    with Gateway(tmp_path, SETTINGS) as gateway, gateway.client() as client, flooding(gateway.endpoint, KEY, flood):
        ran = 0
        for _ in range(TRIES):
            # In the instant of the last Stop it is rejected, and another tick is another instant.
            assert any(client.start_leg(3, 90, 90, 90, check=False).accepted for _ in range(100))
            client.publish(KEY, leg_payload("stop"))
            # By another ring, after the Stop. Only a leg that runs takes it.
            ran += client.set_leg(3, 90, 90, 91, check=False).accepted
        assert ran == 0, f"in {ran} of {TRIES} tries the leg went on running"
