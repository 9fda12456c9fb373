"""A robot of elkapod-2025 that people drive: a walk, and `check --stops`. It starts as a whole, and ends shut down."""

from pathlib import Path

import pytest

from gateway.model.elkapod import SHUTDOWN, START
from gateway.onboard.check.stops import STEPS
from schemas.robot import SERVO_IDS
from tests.hil.elkapod_bed import AT_REST, ElkapodBed
from tests.hil.wire import LATE_S
from tests.support.gateway_process import COMMAND, Gateway

pytestmark = [pytest.mark.hil, pytest.mark.nightly]


def test_it_is_started_once_moved_and_shut_down(tmp_path: Path) -> None:
    with ElkapodBed(tmp_path) as robot:
        sections = robot.settings_with(watchdog={"timeout_ms": 2000})
        with Gateway(tmp_path, sections, bed=robot) as gateway, gateway.client() as client:
            robot.wait_for_count(1, LATE_S)
            since = len(robot.events)
            with client.walk() as walk:
                walk.stand()
                assert robot.controller.energised == frozenset(SERVO_IDS)
                for _ in range(50):
                    walk.go(forward_m_s=0.05)
                walk.sit()
            robot.wait_for_message(SHUTDOWN, since=since, timeout_s=LATE_S)
            said = robot.said_since(since)
            order = [each.what for each in said if isinstance(each.what, str)]
            assert order[0] == "start", "nothing is shut down before it"
            assert order.count("start") == 1
            assert robot.controller.energised == frozenset()
            begun = [each.what for each in said].index("start")
            assert said[begun - 1].what == said[begun - 2].what != AT_REST, "lying, and not in the middle"
            assert len({each.what for each in said}) > 50
        assert not robot.controller.corruptions


def test_check_stops_passes_and_leaves_nothing_energised(tmp_path: Path) -> None:
    with ElkapodBed(tmp_path) as robot:
        sections = robot.settings_with(telemetry={"frames": True}, watchdog={"timeout_ms": 400})
        with Gateway(tmp_path, sections, bed=robot) as gateway:
            options = ("--yes", "--late", "70", "--config", str(gateway.config), "--connect", gateway.endpoint)
            check = robot.spawn([*COMMAND, "check", "--stops", *options])
            assert check.wait(90) == 0, str(check)
            assert check.stdout.count("PASS ") == len(STEPS) - 4, str(
                check
            )  # all but --restart, and those of a power board
            assert "starts and stops as a whole" in check.stderr
            messages = robot.messages_since(0)
            assert messages.count(START) >= 3
            assert messages[-1] == SHUTDOWN
            assert robot.controller.energised == frozenset()
        assert not robot.controller.corruptions
