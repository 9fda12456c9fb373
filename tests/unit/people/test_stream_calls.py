"""What a stream's setpoint costs a program: counted in calls, exactly. Apart from `test_stream`, which judges mutants:
these run with calls of their own.
"""

import json
import sys
from typing import Any

import pytest

from gateway.people.client.stream import Stream
from schemas.robot import LEGS
from tests.unit.people.test_stream import HZ, Robot

MOST_CALLS = 143
"""Of Python functions and of C's, from the angles of six legs to their payload. There were 780 while each angle was
looked at twice, and an abstract class was asked for the type of each leg."""


def test_a_setpoint_takes_no_more_calls_than_it_did(monkeypatch: pytest.MonkeyPatch) -> None:
    robot: Any = Robot()
    monkeypatch.setattr("gateway.people.client.stream.time", robot)
    monkeypatch.setattr(robot, "publish", lambda _key, payload: json.dumps({"sent_ms": 1.0, **payload}))
    counted = 0

    def count(_frame: object, event: str, _argument: object) -> None:
        nonlocal counted
        counted += event in ("call", "c_call")

    with Stream(robot, HZ) as stream:
        angles = dict.fromkeys(LEGS, (91.25, 45.5, 120))
        for _ in range(2):
            stream.set(angles)
            robot.publish_state()
        sys.setprofile(count)
        stream.set(angles)
        sys.setprofile(None)
    assert counted <= MOST_CALLS
