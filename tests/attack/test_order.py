"""No Stop is overtaken by an older Start of its session, pushed out by a flood, or lost among what a link held back."""

import itertools
import json
import random
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import zenoh

from gateway.client import Client
from gateway.people.client.payloads import leg_payload, legs_payload, servo_payload
from schemas import keys
from schemas.keys import LEGS_COMMAND, leg_command, servo_command
from schemas.words import Kind
from tests.benchmarks.processes import flooding, publishing
from tests.support.cut_link import CutLink
from tests.support.gateway_process import Gateway
from tests.support.heard import events

SETTINGS = {"watchdog": {"timeout_ms": 10_000}, "limits": {"leg_rate_hz": 1000}}
TRIES = 160
KEYS = {"legs": LEGS_COMMAND, "leg": leg_command(1), "servo": servo_command(11)}
START, STOP = leg_payload("start", (90, 90, 90)), leg_payload("stop")
STARTS = {"legs": {"legs": {"1": START}}, "leg": START, "servo": servo_payload("start", 90)}
STOPS = {"legs": {"legs": {"1": STOP}}, "leg": STOP, "servo": servo_payload("stop")}
Way = tuple[str, str]
"""A key and a verb."""
WAYS = [(key, verb) for key in KEYS for verb in ("put", "get")]
PAIRS = [(start, stop) for start in WAYS for stop in [*WAYS, *((key, "delete") for key in KEYS)] if start != stop]


def put(client: Client, key: str, payload: dict[str, Any]) -> None:
    """Put it at once. `Client.publish` drops what the sender's own full queue has no room for."""
    block = zenoh.CongestionControl.BLOCK
    client.session.put(key, json.dumps(payload), express=True, congestion_control=block)


def send(client: Client, way: Way, payloads: dict[str, Any]) -> None:
    """Send without waiting for an answer."""
    key, verb = way
    match verb:
        case "put":
            put(client, KEYS[key], payloads[key])
        case "get":
            client.session.get(KEYS[key], lambda _: None, payload=json.dumps(payloads[key]))
        case "delete":
            client.session.delete(KEYS[key], express=True, congestion_control=zenoh.CongestionControl.BLOCK)


def overtaken(client: Client, pairs: list[tuple[Way, Way]], tries: int) -> Counter[tuple[Way, Way]]:
    """Return by pair how often servo 11 ran although its Stop was sent after its Start."""
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
        ran = client.ask(keys.servo_command(11), servo_payload("set", 91)).accepted
        if ran or client.state().legs[0].servos[0].running:
            found[pair] += 1
    return found


@pytest.mark.parametrize("messages_hz", [250, 5000])
def test_no_start_overtakes_a_stop_of_the_same_session(tmp_path: Path, messages_hz: int) -> None:
    traffic = ("--legs", "2", "3", "4", "5", "6", "--hz", str(messages_hz / 5))  # from another process
    with Gateway(tmp_path, SETTINGS) as gateway, gateway.client() as client, publishing(gateway.endpoint, *traffic):
        assert overtaken(client, [(("leg", "put"), ("servo", "put"))], TRIES) == Counter()
        assert overtaken(client, PAIRS, TRIES) == Counter()


FLOODED: dict[str, dict[str, Any]] = {"watchdog": {"timeout_ms": 10_000}}
FLOODS = 200
KEY = leg_command(3)


@pytest.mark.parametrize("flood", [json.dumps(leg_payload("set", (1, 2, 3))), "{ not JSON"])
def test_a_stop_under_a_flood_of_its_own_key_stops(tmp_path: Path, flood: str) -> None:
    with Gateway(tmp_path, FLOODED) as gateway, gateway.client() as client, flooding(gateway.endpoint, KEY, flood):
        ran = 0
        for _ in range(FLOODS):
            # In the instant of the last Stop it is rejected, and another tick is another instant.
            assert any(client.start_leg(3, 90, 90, 90, check=False).accepted for _ in range(100))
            client.publish(KEY, leg_payload("stop"))
            # By another ring, after the Stop. Only a leg that runs takes it.
            ran += client.set_leg(3, 90, 90, 91, check=False).accepted
        assert ran == 0, f"in {ran} of {FLOODS} tries the leg went on running"


POSE = (90, 45, 120)
COUNT = 50
SENT = {
    keys.LEGS_COMMAND: (legs_payload("set", {3: POSE}), legs_payload("stop", {3: ()})),
    keys.leg_command(3): (leg_payload("set", POSE), leg_payload("stop")),
}
"""By its key: a Set and a Stop of leg 3."""


@pytest.mark.parametrize("key", SENT)
def test_no_stop_among_what_was_held_back_is_lost(tmp_path: Path, key: str) -> None:
    """Wherever it is among them, it stops the leg: what comes after it only sets, and so starts nothing."""
    setpoint, stop = SENT[key]
    with (
        Gateway(tmp_path, {"watchdog": {"timeout_ms": 400}}) as gateway,
        gateway.client() as watcher,
        CutLink(gateway.endpoint) as link,
        Client(link.endpoint, source="laptop") as laptop,
    ):
        heard = events(watcher)
        for place in range(0, COUNT, 3):
            assert any(watcher.start_leg(3, *POSE, check=False).accepted for _ in range(100))
            link.hold()
            for number in range(COUNT):
                put(laptop, key, stop if number == place else setpoint)
            link.fix()
            laptop.state()  # on the same link, behind all that was held back
            assert not laptop.set_leg(3, *POSE, check=False).accepted, f"it runs, and the {place}th was a Stop"
        assert not [event for event in heard.all if event.kind == Kind.OVERFLOW]


@pytest.mark.parametrize(("count", "exact"), [(30, True), (55, True), (2000, False)])
def test_each_message_is_counted_once(tmp_path: Path, count: int, exact: bool) -> None:
    """If a ring overflows, the counter of lost messages is a lower bound."""
    key = keys.leg_command(3)
    with Gateway(tmp_path) as gateway, CutLink(gateway.endpoint) as link, Client(link.endpoint) as laptop:
        link.hold()
        for _ in range(count):
            put(laptop, key, SENT[key][0])
        link.fix()
        assert not laptop.set_leg(3, *POSE, check=False).accepted  # on the same link, after all that was held back
        counts = laptop.state().commands
        counted = counts.accepted + counts.rejected + counts.passed_over + counts.lost
        assert counted == count + 1 if exact else count >= counted
        assert exact or counts.passed_over + counts.lost > 0
