"""No Stop among what a link held back, and then delivers at once, is lost; and a stream of that length is no flood."""

import json
from pathlib import Path

import pytest
import zenoh

from gateway.client import Client, leg_payload, legs_payload
from schemas import keys
from schemas.telemetry import Kind
from tests.support.cut_link import CutLink
from tests.support.gateway_process import Gateway
from tests.support.heard import events

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
                # Not `Client.publish`: which drops what its own full queue has no room for.
                laptop.session.put(
                    key,
                    json.dumps(stop if number == place else setpoint),
                    express=True,
                    congestion_control=zenoh.CongestionControl.BLOCK,
                )
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
            laptop.session.put(
                key, json.dumps(SENT[key][0]), express=True, congestion_control=zenoh.CongestionControl.BLOCK
            )
        link.fix()
        assert not laptop.set_leg(3, *POSE, check=False).accepted  # on the same link, after all that was held back
        counts = laptop.state().commands
        counted = counts.accepted + counts.rejected + counts.passed_over + counts.lost
        assert counted == count + 1 if exact else count >= counted
        assert exact or counts.passed_over + counts.lost > 0
