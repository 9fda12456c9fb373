"""On a machine with far too much to do, no servo is left unattended, and nothing that was accepted is lost.

Fifty clients, a flood, questions, and a spinning process on every core.

python -m tests.hil.test_load ENDPOINT    fifty sessions, each listening, and commanding what the gateway rejects
"""

import itertools
import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

import pytest
import zenoh
from zenoh.handlers import RingChannel

from gateway.model.frames import decode
from gateway.people.client.payloads import leg_payload
from gateway.zenoh.config import client_config
from schemas.keys import EVENT, STATE, leg_command
from schemas.robot import LEGS
from schemas.words import Mode
from tests.benchmarks.processes import flooding, program
from tests.benchmarks.publisher import payload
from tests.hil.bed import SpiTestbed
from tests.support.child import Child
from tests.support.gateway_process import Gateway
from tests.support.waiting import wait_until

pytestmark = [
    pytest.mark.hil,
    # Priority is what makes the tail short: without it, a spinning process may keep the processor for several turns.
    pytest.mark.skipif(os.geteuid() != 0, reason="the gateway gets real-time priority only as root, or from systemd"),
    pytest.mark.alone,
]

CLIENTS: Final = 50
FLOODED_LEG: Final = 1
TIMEOUT_MS: Final = 100.0
LATE_MS: Final = 20.0
"""Beside what this machine lets any process of that priority wait."""
DURATION_S, LONGEST_S = 6.0, 60.0
SPEECH_S, SILENCE_S = 0.5, 0.25
"""The stream of setpoints comes and goes: each silence is work for the watchdogs of the five legs without a flood."""

COLLECTOR: Final = """
import gc, threading, time

def collect():
    while True:
        time.sleep(0.1)
        gc.collect()

threading.Thread(target=collect, daemon=True).start()
"""
"""Forces a full garbage collection every 100 ms in whatever Python program finds it as `sitecustomize`."""

PAUSES: Final = """
import os, select, sys, time

os.sched_setaffinity(0, [int(sys.argv[1])])
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30))
longest_s = 0.0
while not select.select([sys.stdin], [], [], 0)[0]:
    begun_s = time.monotonic()
    time.sleep(0.001)
    longest_s = max(longest_s, time.monotonic() - begun_s)
print(longest_s * 1000, flush=True)
"""
"""How long, in ms, a processor lets a Python program wait that has the gateway's priority, and does nothing."""


@contextmanager
def crowd(endpoint: str) -> Iterator[None]:
    """Yield all of them at work."""
    with ExitStack() as stack:
        many = stack.enter_context(Child([sys.executable, "-m", "tests.hil.test_load", endpoint], os.environ))
        many.wait_for_output("commanding", timeout_s=30)
        stack.enter_context(flooding(endpoint, STATE, "", "--ask"))
        stack.enter_context(flooding(endpoint, leg_command(FLOODED_LEG), payload(0)))
        for _ in range(os.cpu_count() or 1):
            stack.callback(Child([sys.executable, "-c", "while True: pass"], os.environ).close)
        yield


def test_no_servo_is_unattended_under_load_and_nothing_accepted_is_lost(
    tmp_path: Path, spi_testbed: SpiTestbed
) -> None:
    """While garbage is collected ten times a second, too."""
    (tmp_path / "sitecustomize.py").write_text(COLLECTOR)
    env = {"PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])}
    settings: dict[str, dict[str, Any]] = {
        "watchdog": {"timeout_ms": TIMEOUT_MS},
        "limits": {"takeover_deg_s": 0},  # each command is one frame, also soon behind a Stop
    }
    with (
        Gateway(tmp_path, settings, bed=spi_testbed, env=env) as gateway,
        gateway.client() as client,
        ExitStack() as stack,
        program("publisher", gateway.endpoint, "--legs", *map(str, LEGS), "--hz", "50") as stream,
    ):
        pauses = [
            stack.enter_context(Child([sys.executable, "-c", PAUSES, str(cpu)], {**os.environ, **env}))
            for cpu in os.sched_getaffinity(0)
        ]
        stream.wait_for_output("ready", timeout_s=20)
        with crowd(gateway.endpoint):
            begun_s = time.monotonic()
            while time.monotonic() < begun_s + DURATION_S or client.state().watchdog.expirations < 25:
                assert time.monotonic() < begun_s + LONGEST_S, "the watchdog had no work"
                stream.ask(str(SPEECH_S), timeout_s=30)
                time.sleep(SILENCE_S)
        wait_until(lambda: client.state().mode == Mode.IDLE, "no leg is left running")
        transfers, state, pause_ms = spi_testbed.transfers, client.state(), max(float(each.ask("")) for each in pauses)
    gaps_ms = []
    for leg in LEGS:
        of_leg = [each for each in transfers if each.data[2] // 10 == leg]
        assert decode(of_leg[-1].data).is_stop, f"leg {leg} was left running"
        gaps_ms += [
            (later.monotonic_ns - earlier.monotonic_ns) / 1e6
            for earlier, later in itertools.pairwise(of_leg)
            if not decode(earlier.data).is_stop
        ]
    late, late_ms = state.watchdog.stop_latency_us, LATE_MS + min(pause_ms, 1000)
    print(f"{len(gaps_ms)} moves; longest gap {max(gaps_ms):.1f} ms; watchdog {late}; pauses {pause_ms:.1f} ms")
    assert late.max is not None
    assert late.max <= late_ms * 1000
    assert max(gaps_ms) <= TIMEOUT_MS + late_ms
    assert len(gaps_ms) == state.commands.accepted - state.commands.coalesced


def clients(endpoint: str) -> None:
    """Let clients listen to state and events (nobody reads: rings), and send commands that are rejected."""
    sessions = [zenoh.open(client_config(endpoint)) for _ in range(CLIENTS)]
    listeners = [session.declare_subscriber(key, RingChannel(1)) for session in sessions for key in (STATE, EVENT)]
    print("commanding", len(listeners), flush=True)
    wrong = json.dumps(leg_payload("set", (1, 2, 180))).replace("180", "181")
    for session in itertools.cycle(sessions):
        session.put(leg_command(6), wrong)
        time.sleep(0.2 / CLIENTS)


if __name__ == "__main__":
    clients(sys.argv[1])
