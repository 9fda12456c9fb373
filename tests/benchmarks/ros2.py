"""`python -m tests.benchmarks.ros2`: what the ROS 2 bridge adds to a command, and what it uses.

The same 18 joints at 50 Hz, by a plain client of the gateway and by a ROS peer through its router and the bridge, in
turn; each to a simulated gateway, until its FrameRecord's own time. Router and peer are processes as with ROS 2. The
router is a Zenoh session in Python in router mode.
"""

import itertools
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import zenoh

from gateway.client import Client
from gateway.model.frames import decode
from gateway.people.ros2.cdr import encode
from gateway.people.ros2.joints import legs_deg
from gateway.people.ros2.messages import TRIGGER_HASH, TRIGGER_TYPE, JointState, TriggerRequest
from gateway.people.ros2.wire import Attachment
from schemas import keys
from schemas.robot import SERVO_IDS
from tests.benchmarks.processes import Figures, cpu_ns, now_ns, rss_kb, say, threads
from tests.support.bridged import GEOMETRY, Bridge, resting
from tests.support.child import Child
from tests.support.gateway_process import Gateway, free_port
from tests.support.heard import frames

ROUNDS: Final = 3
ROUND_S: Final = 8.0
HZ: Final = 50.0
SETTINGS: Final[dict[str, dict[str, Any]]] = {
    "limits": {"leg_rate_hz": 200},  # no command waits for its leg's rate slot
    "telemetry": {"frames": True},
    "watchdog": {"timeout_ms": 2000},
}
ROUTER: Final = """
import json, sys, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config):
    print("ready", flush=True)
    sys.stdin.read()
"""
FIRST_SERVO: Final = 11


def main() -> None:
    """Measure, and print a table."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with tempfile.TemporaryDirectory() as folder, Gateway(Path(folder), SETTINGS) as gateway:
        router = Child([sys.executable, "-c", ROUTER, endpoint], os.environ)
        try:
            router.wait_for_output("ready", timeout_s=20)
            with _peer(endpoint) as session, Bridge(gateway, endpoint, session) as bridge, gateway.client() as client:
                _measure(bridge, client)
        finally:
            router.close()


def _measure(bridge: Bridge, client: Client) -> None:
    publisher = bridge.publisher("joint_commands", JointState)
    plain_ns: list[int] = []
    bridged_ns: list[int] = []
    used: list[float] = []
    idle = _share(bridge.child.pid, lambda: time.sleep(ROUND_S))
    for _ in range(ROUNDS):
        with client.lease():
            client.start_legs(legs_deg(GEOMETRY, _at_rad(resting())))
            plain_ns += _round(client, lambda message: client.publish(keys.LEGS_COMMAND, _legs(message)))
            client.stop()
        bridge.call("drive", bridge.names.key("drive", TRIGGER_TYPE, TRIGGER_HASH), **_request())
        for _ in range(12):
            publisher.publish(resting())
            time.sleep(1 / HZ)
        used.append(_share(bridge.child.pid, lambda: bridged_ns.extend(_round(client, publisher.publish))))
        bridge.call("release", bridge.names.key("release", TRIGGER_TYPE, TRIGGER_HASH), **_request())
    plain, bridged = Figures.of(plain_ns), Figures.of(bridged_ns)
    say(f"message → frame of joint 11, {len(plain_ns)} and {len(bridged_ns)} messages of 18 joints at {HZ:g} Hz")
    say(f"  plain client of the gateway: {_shown(plain)}")
    say(f"  ROS peer, router, bridge:    {_shown(bridged)}")
    say(f"  added: {(bridged.p50_us - plain.p50_us) / 1000:.2f} ms in the median")
    say(f"CPU of the bridge: {idle:.1%} of a core idle, {min(used):.1%} to {max(used):.1%} at {HZ:g} Hz each way")
    say(f"  {rss_kb(bridge.child.pid) / 1000:.0f} MB resident, {threads(bridge.child.pid)} threads")


def _round(client: Client, publish: Callable[[JointState], object]) -> list[int]:
    """Latencies: each message turns joint 11 to an angle of its own, by which its frame is known."""
    written = frames(client)
    sent_ns: dict[int, int] = {}
    begun_s = time.monotonic()
    for number in itertools.count():
        due_s = begun_s + number / HZ
        if due_s - begun_s > ROUND_S:
            break
        time.sleep(max(0.0, due_s - time.monotonic()))
        message = resting(joint_11=(number + 1) / 1000)
        angle_deg = GEOMETRY.servos[FIRST_SERVO].servo_deg(message.position[0])
        sent_ns[round(angle_deg * 100)] = now_ns()
        publish(message)
    time.sleep(0.5)
    return [
        record.monotonic_ns - sent_ns[command.angle_cdeg]
        for record in written.all
        for servo_id, command in decode(bytes.fromhex(record.bytes)).servos
        if servo_id == FIRST_SERVO and command.angle_cdeg in sent_ns
    ]


def _share(pid: int, work: Callable[[], object]) -> float:
    """Of one core, meanwhile."""
    begun_ns, begun_cpu_ns = now_ns(), cpu_ns(pid)
    work()
    return (cpu_ns(pid) - begun_cpu_ns) / (now_ns() - begun_ns)


def _peer(endpoint: str) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("connect/endpoints", f'["{endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def _at_rad(message: JointState) -> dict[int, float]:
    return dict(zip(SERVO_IDS, message.position, strict=True))


def _legs(message: JointState) -> dict[str, Any]:
    legs = legs_deg(GEOMETRY, _at_rad(message))
    return {
        "legs": {str(leg): {"servos": [{"op": "set", "angle_deg": each} for each in legs[leg]]} for leg in sorted(legs)}
    }


def _request() -> dict[str, Any]:
    return {"payload": encode(TriggerRequest()), "attachment": Attachment(1, time.time_ns(), bytes(16)).to_bytes()}


def _shown(figures: Figures) -> str:
    return f"p50 {figures.p50_us / 1e3:.2f}, p99 {figures.p99_us / 1e3:.2f}, max {figures.max_us / 1e3:.2f} ms"


if __name__ == "__main__":
    main()
