"""Whoever may press or stop cannot make the black box forget what came before."""

import json
import os
import sys
import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, Final

import pytest

from gateway.model.black_box import format as form
from gateway.model.black_box.files import RING_FILE
from gateway.people.incidents import ring_reader
from gateway.people.incidents.story import story
from gateway.people.incidents.watcher import IncidentWatcher
from gateway.people.recordings import read
from schemas import keys
from tests.support.child import Child
from tests.support.gateway_process import Gateway

SECONDS: Final = 10
"""The shortest ring has 13 000 records. In 3 s these floods made it come round, with the longest incident before it."""
FLOOD_S: Final = 8.0
FLOODS: Final = {
    "emergency stops": (keys.ESTOP, json.dumps({"source": "mallory"})),
    "Stops on a wildcard": ("hexapod/servo/*/cmd", json.dumps({"op": "stop", "source": "mallory"})),
}


@pytest.mark.parametrize("flood", FLOODS)
def test_eight_seconds_of_a_flood_leave_what_precedes_the_incident(tmp_path: Path, flood: str) -> None:
    box = tmp_path / "box"
    settings: dict[str, dict[str, Any]] = {
        "recorder": {"path": str(box), "seconds": SECONDS},
        "log": {"level": "error"},
    }
    with ExitStack() as stack:
        gateway = stack.enter_context(Gateway(tmp_path, settings))
        anna = stack.enter_context(gateway.client(source="anna"))
        keeper = IncidentWatcher(box)
        assert anna.start_leg(3, 90, 45, 120).accepted
        for number in range(10):
            assert anna.set_leg(3, 90, 45, 100 + number).accepted
            time.sleep(0.02)
        assert anna.estop().accepted
        command = [sys.executable, "-m", "tests.attack.flood", gateway.endpoint, *FLOODS[flood]]
        flooding = stack.enter_context(closing(Child(command, os.environ)))
        flooding.wait_for_output("flooding")
        end_s = time.monotonic() + FLOOD_S
        while time.monotonic() < end_s:
            keeper.look()
            time.sleep(0.5)
        flooding.close()
        records = ring_reader.read(box / RING_FILE).records
        of_anna = [each for each in records if getattr(each.content, "source", None) == "anna"]
        assert len([each for each in of_anna if isinstance(each.content, form.CommandRecord)]) >= 11
        assert any(isinstance(each.content, form.LeftOut) for each in records)
        keeper.keep()
    paths = sorted((box / "incidents").glob("*.mcap"))
    commands = [each for each in read(paths[0]) if each.topic == keys.leg_command(3)]
    assert [each.content["source"] for each in commands] == ["anna"] * 11
    assert any("left out" in line for line in story(list(read(paths[0]))))
