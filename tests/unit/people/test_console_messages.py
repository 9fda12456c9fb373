"""What the console takes from a page, and what it ends a WebSocket for."""

import json
from typing import Any

import pytest
from pydantic import ValidationError

from gateway.people.console.pages.page_messages import FROM_PAGE, CommandRequest

SET = {"op": "set", "angle_deg": 90.5}
START = {"op": "start", "angle_deg": 90}
STOP = {"op": "stop"}
LEG = {"servos": [SET, START, STOP]}


def command(key: str, payload: Any, **more: Any) -> dict[str, Any]:
    return {"type": "command", "key": key, "payload": payload, "sent_ms": 12.5, **more}


@pytest.mark.parametrize(
    ("message", "only_stops"),
    [
        (command("hexapod/leg/3/cmd", LEG, id=1), False),
        (command("hexapod/leg/3/cmd", {"servos": [STOP, STOP, STOP]}), True),
        (command("hexapod/legs/cmd", {"legs": {"1": LEG, "6": LEG}}), False),
        (command("hexapod/legs/cmd", {"legs": {"1": {"servos": [STOP, STOP, STOP]}}}), True),
        (command("hexapod/servo/63/cmd", START), False),
        (command("hexapod/servo/63/cmd", STOP), True),
    ],
)
def test_commands(message: dict[str, Any], only_stops: bool) -> None:
    found = FROM_PAGE.validate_json(json.dumps(message))
    assert isinstance(found, CommandRequest)
    assert found.only_stops is only_stops
    assert json.loads(found.payload.model_dump_json(exclude_unset=True)) == message["payload"]


@pytest.mark.parametrize(
    "message",
    [
        {"type": "alive", "now_ms": 0.1},
        {"type": "stop_all", "id": 0},
        {"type": "reset", "id": 4, "estop": 7, "sent_ms": 12},
        {"type": "lease", "id": 4, "do": "acquire"},
        {"type": "lease", "id": 4, "do": "release", "to": "bert"},
        {"type": "link_for", "id": 3},
        {"type": "walk", "id": 9, "press": 3, "sent_ms": 1, "left_m_s": 1, "gait": "wave"},
        {"type": "walk", "id": 9, "press": 3, "sent_ms": 1, "height_m": 0.1, "sits": True},
        {"type": "calibrate", "id": 5, "do": "test", "servo": 32, "deg": 90},
        {"type": "calibrate", "id": 5, "do": "jog", "deg": -0.1},
    ],
)
def test_the_others(message: dict[str, Any]) -> None:
    FROM_PAGE.validate_json(json.dumps(message))


@pytest.mark.parametrize(
    "message",
    [
        [],
        {"type": "shutdown"},
        {"type": "walk", "id": 9, "press": 3, "sent_ms": 12.5, "forward_m_s": 1.1},
        {"type": "walk", "id": 9, "press": 3, "sent_ms": 12.5, "gait": "gallop"},
        {"type": "walk", "id": 9, "press": 3, "sent_ms": 12.5, "height_m": 0},
        {"type": "calibrate", "id": 5, "do": "jog", "deg": 1e9},
        {"type": "calibrate", "id": 5, "do": "test", "deg": 90},
        {"type": "calibrate", "id": 5, "do": "undo", "servo": 32},
        {"type": "alive", "now_ms": -1},
        {"type": "stop_all", "id": 2**60},
        {"type": "stop_all", "id": 1, "please": True},
        {"type": "reset", "id": 4, "sent_ms": 12},
        {"type": "lease", "id": 4, "do": "challenge"},
        {"type": "lease", "id": 4, "do": "acquire", "to": "bert"},
        {"type": "lease", "id": 4, "do": "release", "to": ""},
        command("hexapod/leg/3/cmd", START),
        command("hexapod/leg/7/cmd", LEG),
        command("hexapod/servo/11/cmd", {"op": "set", "angle_deg": 181}),
        command("hexapod/servo/11/cmd", {**STOP, "source": "somebody else"}),
        command("hexapod/estop/cmd", {}),
        command("hexapod/state", STOP),
        command("hexapod/legs/cmd", {"legs": {}}),
        command("hexapod/leg/3/cmd", LEG, id="1"),
        {key: value for key, value in command("hexapod/leg/3/cmd", LEG).items() if key != "sent_ms"},
    ],
)
def test_what_ends_the_websocket(message: Any) -> None:
    with pytest.raises(ValidationError):
        FROM_PAGE.validate_json(json.dumps(message))
