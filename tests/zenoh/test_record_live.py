"""`record --live` against a real gateway, with a viewer's side of its WebSocket."""

import json
import math
import os
import re
import signal
import time
from contextlib import closing
from typing import Any

from websockets import Subprotocol
from websockets.sync.client import ClientConnection, connect

from gateway.people.recorder.drawing import DRAWN, SIM_JOINT_STATES
from gateway.people.recorder.record import REPORTS
from schemas.keys import SIM_BODY, STATE, TELEMETRY
from tests.support.child import Child
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.measuring import MEASURED
from tests.support.ros2_messages import decode

PATIENCE_S = 30


gateway = gateway_fixture({"telemetry": {"frames": True}})


def address_of(child: Child) -> str:
    found = re.search(r"ws://127\.0\.0\.1:\d+", child.wait_for_output("ws://"))
    assert found is not None
    return found[0]


def text(viewer: ClientConnection, op: str) -> dict[str, Any]:
    while True:
        message = viewer.recv(PATIENCE_S)
        if isinstance(message, str) and (found := json.loads(message))["op"] == op:
            assert isinstance(found, dict)
            return found


def test_a_viewer_sees_all_channels_and_publishes_nothing(gateway: Gateway) -> None:
    command = [*COMMAND, "record", "--live", "--port", "0", "--connect", gateway.endpoint]
    with closing(Child(command, os.environ)) as child, gateway.client() as robot:
        # The server answers no closing handshake while it sends, and nobody here waits for that.
        with connect(address_of(child), subprotocols=[Subprotocol("foxglove.sdk.v1")], close_timeout=0.1) as viewer:
            assert text(viewer, "serverInfo")["capabilities"] == []
            channels: dict[int, Any] = {}
            while len(channels) < len(REPORTS) + len(DRAWN):
                channels |= {channel["id"]: channel for channel in text(viewer, "advertise")["channels"]}
            assert {channel["topic"] for channel in channels.values()} == REPORTS.keys() | DRAWN.keys()

            viewer.send(json.dumps({"op": "advertise", "channels": [
                {"id": 1, "topic": "hexapod/legs/cmd", "encoding": "json", "schemaName": "LegsCommand"}
            ]}))  # fmt: skip
            assert "clientPublish" in text(viewer, "status")["message"]
            viewer.send(b"\x01\x01\x00\x00\x00" + json.dumps({"legs": {"1": {}}}).encode())
            assert text(viewer, "status")["level"] == 2, "an error"

            subscriptions = [{"id": each, "channelId": each} for each in channels]
            viewer.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
            seen: set[str] = set()
            wanted = (REPORTS.keys() | DRAWN.keys()) - {SIM_BODY, SIM_JOINT_STATES}
            begun_s, moved_s = time.monotonic(), -math.inf
            while not seen >= wanted:
                assert time.monotonic() - begun_s < 6 * PATIENCE_S, wanted - seen
                message = viewer.recv(PATIENCE_S)
                if isinstance(message, str):
                    continue
                channel = channels[int.from_bytes(message[1:5], "little")]
                if (kind := DRAWN.get(channel["topic"])) is None:
                    assert channel["schema"] == ""
                    REPORTS[channel["topic"]].model_validate_json(message[13:])
                else:
                    assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
                    decode(kind, message[13:])
                # Again: a server that is not read in time leaves messages out.
                if channel["topic"] == STATE and time.monotonic() - moved_s > 1:
                    moved_s = time.monotonic()
                    assert robot.start_leg(1, 90, 90, 90).accepted  # something to see
                    robot.stop()
                    assert not robot.set_leg(1, 90, 90, 90, check=False).accepted
                    assert robot.calibrate(landing={11: 45}).accepted
                    robot.session.put(TELEMETRY, MEASURED.model_dump_json())  # in the gateway's place
                seen.add(channel["topic"])
            assert robot.state().commands.rejected > 0
            assert robot.state().mode == "idle"

        taken = gateway.run("record", "--live", "--port", address_of(child).rpartition(":")[2])
        assert taken.returncode == 5, str(taken)
        child.send_signal(signal.SIGINT)
        assert child.wait() == 0, str(child)
