"""A stop button whose link is cut: all six legs stop once its latest check-in counts no more, and none starts again.

`CUTS=100 pytest tests/net/test_buttons.py -rP` prints the figures of docs/buttons.md.
"""

import os
import statistics
from pathlib import Path

import pytest

from schemas.robot import LEGS
from schemas.telemetry import Kind, Reason
from tests.net.hosts import LaptopHost, RobotHost, is_stop
from tests.net.namespaces import Network

pytestmark = pytest.mark.net

PORT = 7452
CUTS = int(os.environ.get("CUTS", "3"))  # CUTS=100 takes a minute and a half
TIMEOUT_MS = 500
LATE_MS = 500
"""What a busy machine may add."""
SETTINGS = {"buttons": {"required": 1, "timeout_ms": TIMEOUT_MS}, "watchdog": {"timeout_ms": 10_000}}
POSE = dict.fromkeys(LEGS, (90, 45, 120))


def test_a_link_that_is_cut_stops_all_six_legs_and_nothing_starts_once_it_is_back(
    network: Network, tmp_path: Path
) -> None:
    after_ms: list[float] = []
    with (
        LaptopHost(network, 0, port=PORT) as watcher,
        RobotHost(network, tmp_path, port=PORT, settings=SETTINGS) as robot,
    ):
        watcher.ask("watch")
        for _ in range(CUTS):
            watcher.ask("checked-in")
            assert robot.client.start_legs(POSE).accepted
            robot.forget()
            sent_ns = watcher.ask("checked-in")["sent_ns"]
            network.cut(0)
            silent = robot.wait_for_event(lambda event: event.kind == Kind.BUTTON_SILENT)
            robot.wait_for_frames(is_stop(*LEGS), len(LEGS))
            stops = robot.seen(is_stop(*LEGS))
            assert len(stops) == len(silent.legs) == len(LEGS)
            after_ms.append((stops[-1].monotonic_ns - sent_ns) / 1e6)
            assert robot.client.start_leg(1, POSE[1]).reason == Reason.NO_BUTTON
            network.fix(0)
            robot.wait_for_event(lambda event: event.kind == Kind.BUTTON_RETURNED)
            assert not robot.running
    late_ms = [each - TIMEOUT_MS for each in after_ms]
    print(
        f"{CUTS} links cut: latest check-in sent → sixth Stop, beyond the {TIMEOUT_MS} ms that it counts: "
        f"p50 {statistics.median(late_ms):.2f} ms, worst {max(late_ms):.2f} ms, least {min(late_ms):.2f} ms"
    )
    assert min(late_ms) > -1
    assert max(late_ms) < LATE_MS
