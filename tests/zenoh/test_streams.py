"""Ordinary programs without `sent_ms`, over Zenoh: each message is taken, and each leg moves."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Final

import pytest

from schemas import keys
from schemas.gateway_state import GatewayState
from schemas.robot import LEGS
from tests.support.gateway_process import Gateway
from tests.support.heard import frames, last_angles, states

pytestmark = pytest.mark.full

LEG: Final = {"servos": [{"op": "OP", "angle_deg": angle_deg} for angle_deg in (90, 45, 120)]}
SENT: Final[dict[str, dict[str, object]]] = {
    "legs": {keys.LEGS_COMMAND: {"legs": {str(leg): LEG for leg in LEGS}}},
    "one leg": {keys.leg_command(1): LEG},
    "six legs": {keys.leg_command(leg): LEG for leg in LEGS},
    "a servo": {keys.servo_command(11): LEG["servos"][0]},
}
"""The payload on each key; OP becomes `start` or `set`."""
PROGRAM: Final = """
import json, sys, time, zenoh

endpoint, rate_hz, verb, express, sent = json.loads(sys.argv[1])
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([endpoint]))
with zenoh.open(config) as session:
    puts, gets = 0, []
    for number in range(rate_hz):
        for key, (start, then) in sent.items():
            payload = then if number else start
            if verb == "put":
                session.put(key, payload, express=express, congestion_control=zenoh.CongestionControl.BLOCK)
                puts += 1
            else:
                gets.append(session.get(key, payload=payload))
        time.sleep(1 / rate_hz)
    list(session.get("hexapod/state"))  # behind all puts: none is lost at the session's end
    print(puts + sum(len(list(replies)) for replies in gets))  # a get that others displaced has none
"""


def counts(state: GatewayState) -> tuple[int, ...]:
    commands = state.commands
    return commands.accepted, commands.rejected, commands.passed_over, commands.lost


@pytest.mark.parametrize(
    ("name", "rate_hz", "then", "verb", "express"),
    [
        ("legs", 200, "set", "put", False),
        ("legs", 1000, "start", "get", True),
        ("one leg", 50, "start", "put", True),
        ("one leg", 300, "set", "get", False),
        ("one leg", 1000, "set", "put", True),
        ("six legs", 50, "set", "get", False),
        ("six legs", 200, "start", "put", False),
        ("six legs", 300, "set", "put", True),
        ("a servo", 200, "start", "get", False),
        ("a servo", 1000, "set", "put", False),
    ],
)
def test_a_stream_of_any_rate_moves_the_robot(
    tmp_path: Path, name: str, rate_hz: int, then: str, verb: str, express: bool
) -> None:
    """A second of it is sent. `coalesced` shows that it is thinned to the rate of the legs, not refused."""
    sent = {key: [json.dumps(each).replace("OP", op) for op in ("start", then)] for key, each in SENT[name].items()}
    settings: dict[str, dict[str, object]] = {"telemetry": {"frames": True}, "watchdog": {"timeout_ms": 2000}}
    with Gateway(tmp_path, settings) as gateway, gateway.client() as watcher:
        heard, counted = frames(watcher), states(watcher, kept=20)
        argument = json.dumps([gateway.endpoint, rate_hz, verb, express, sent])
        count = int(subprocess.check_output([sys.executable, "-c", PROGRAM, argument], timeout=60))
        counted.wait(lambda state: sum(counts(state)) == count)
        assert watcher.state().commands.rejected == 0
        legs = set(LEGS) if "legs" in name else {1}
        heard.wait_for_all(lambda records: {servo_id // 10 for servo_id in last_angles(records)} == legs)
        assert watcher.state().commands.coalesced > 0 or rate_hz == 50
