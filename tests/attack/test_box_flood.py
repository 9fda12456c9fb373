"""A flood of emergency stops or Stops does not erase what came before it from the black box."""

import json
import os
import sys
import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, Final

import pytest

from gateway.model.black_box.files import RING_FILE
from gateway.people.recorder import ring_reader
from gateway.people.recorder.incidents import find
from gateway.people.recorder.messages import messages
from gateway.people.recorder.story import story
from schemas import keys
from tests.support.child import Child
from tests.support.gateway_process import Gateway

RATE_HZ: Final = 10
"""The ring then has 20 400 records, fewer than these floods made before sources had shares."""
FLOOD_S: Final = 8.0
FLOODS: Final = {
    "emergency stops": (keys.ESTOP, json.dumps({"source": "mallory"})),
    "Stops on a wildcard": ("hexapod/servo/*/cmd", json.dumps({"op": "stop", "source": "mallory"})),
}


@pytest.mark.parametrize("flood", FLOODS)
def test_eight_seconds_of_a_flood_leave_what_precedes_the_incident(tmp_path: Path, flood: str) -> None:
    box = tmp_path / "box"
    settings: dict[str, dict[str, Any]] = {
        "state": {"path": str(box)},
        "limits": {"leg_rate_hz": RATE_HZ},
    }
    with ExitStack() as stack:
        gateway = stack.enter_context(Gateway(tmp_path, settings))
        anna = stack.enter_context(gateway.client(source="anna"))
        assert anna.start_leg(3, 90, 45, 120).accepted
        for number in range(10):
            assert anna.set_leg(3, 90, 45, 100 + number).accepted
            time.sleep(2 / RATE_HZ)
        assert anna.estop().accepted
        command = [sys.executable, "-m", "tests.attack.flood", gateway.endpoint, *FLOODS[flood]]
        flooding = stack.enter_context(closing(Child(command, os.environ)))
        flooding.wait_for_output("flooding")
        time.sleep(FLOOD_S)
        flooding.close()
    content = ring_reader.read(box / RING_FILE)
    incident = find(content.records, written=False)[0]
    told = list(messages(incident, content.records))
    commands = [each for each in told if each.topic == keys.leg_command(3)]
    assert [each.content["source"] for each in commands] == ["anna"] * 11
    assert any("left out" in line for line in story(told))
