"""A Stop is never overtaken by an older Start of the same session, whatever keys and verbs the two take.

Through the real Zenoh, from process to process, beside others' traffic: an older Start waits in a ring that has been
read already, or its wakeup is still with the thread that waits for it, when the Stop is taken from another ring.
"""

import itertools
import json
import random
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import zenoh

from gateway.client import Client, leg_payload, servo_payload
from schemas.keys import LEGS_COMMAND, leg_command, servo_command
from tests.benchmarks.processes import publishing
from tests.support.gateway_process import Gateway

SETTINGS = {"watchdog": {"timeout_ms": 10_000}, "limits": {"leg_rate_hz": 1000}}
TRIES = 160
BLOCK = zenoh.CongestionControl.BLOCK
KEYS = {"legs": LEGS_COMMAND, "leg": leg_command(1), "servo": servo_command(11)}
START, STOP = leg_payload("start", (90, 90, 90)), leg_payload("stop")
STARTS = {"legs": {"legs": {"1": START}}, "leg": START, "servo": servo_payload("start", 90)}
STOPS = {"legs": {"legs": {"1": STOP}}, "leg": STOP, "servo": servo_payload("stop")}
Way = tuple[str, str]
"""A key and a verb."""
WAYS = [(key, verb) for key in KEYS for verb in ("put", "get")]
PAIRS = [(start, stop) for start in WAYS for stop in [*WAYS, *((key, "delete") for key in KEYS)] if start != stop]


def send(client: Client, way: Way, payloads: dict[str, Any]) -> None:
    """Send without waiting for an answer; a put is not dropped where the sender's own queue is full, as it would be."""
    key, verb = way
    match verb:
        case "put":
            client.session.put(KEYS[key], json.dumps(payloads[key]), express=True, congestion_control=BLOCK)
        case "get":
            client.session.get(KEYS[key], lambda _: None, payload=json.dumps(payloads[key]))
        case "delete":
            client.session.delete(KEYS[key], express=True, congestion_control=BLOCK)


def overtaken(client: Client, pairs: list[tuple[Way, Way]], tries: int) -> Counter[tuple[Way, Way]]:
    """By pair, how often servo 11 ran although its Stop was sent after its Start."""
    found: Counter[tuple[Way, Way]] = Counter()
    chance = random.Random(1)  # noqa: S311
    for pair in itertools.islice(itertools.cycle(pairs), tries):
        assert client.stop(1).accepted
        for _ in range(chance.randrange(3)):  # tries are not to stay synchronised with the traffic
            client.state()
        start, stop = pair
        send(client, start, STARTS)
        send(client, stop, STOPS)
        # Sent after both, so it comes when both are there. Only a servo that runs takes it.
        ran = client.servo(11, "set", 91, check=False).accepted
        if ran or client.state().legs[0].servos[0].running:
            found[pair] += 1
    return found


@pytest.mark.parametrize("messages_hz", [250, 5000])
def test_no_start_overtakes_a_stop_of_the_same_session(tmp_path: Path, messages_hz: int) -> None:
    traffic = ("--legs", "2", "3", "4", "5", "6", "--hz", str(messages_hz / 5))  # from another process
    with Gateway(tmp_path, SETTINGS) as gateway, gateway.client() as client, publishing(gateway.endpoint, *traffic):
        assert overtaken(client, [(("leg", "put"), ("servo", "put"))], TRIES) == Counter()
        assert overtaken(client, PAIRS, TRIES) == Counter()
