"""The commands at `run --sim=physics`: they work as at any gateway, and one sees the fall that an incident caused."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

from schemas.keys import SIM_BODY
from schemas.telemetry import BodyReport, Cause
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.heard import Heard, frames

WATCHDOG_MS: Final = 1000
"""It outlasts a moment in which this machine is busy."""
STANDS_M: Final = 0.12
LIES_M: Final = 0.1


@pytest.fixture(scope="module")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gateway]:
    folder = tmp_path_factory.mktemp("physics")
    settings: dict[str, dict[str, Any]] = {
        "telemetry": {"frames": True},
        "watchdog": {"timeout_ms": WATCHDOG_MS},
        "recorder": {"path": str(folder / "box")},
    }
    with Gateway(folder, settings, env={"XDG_RUNTIME_DIR": str(folder)}, options=("--sim=physics",)) as running:
        yield running


def test_the_drill_passes(gateway: Gateway) -> None:
    steps = ("command", "silence", "estop", "after-reset")
    done = gateway.run("drill", "--late", "70", *(option for step in steps for option in ("--only", step)))
    assert done.returncode == 0, str(done)
    assert done.stdout.count("PASS ") == len(steps)


def test_an_incident_is_replayed_and_the_robot_falls_again(gateway: Gateway, tmp_path: Path) -> None:
    """A walking program is killed; what the black box kept of it is replayed."""
    incident = tmp_path / "fall.mcap"
    with gateway.client() as client:
        written, body = frames(client), Heard(client, SIM_BODY, BodyReport)
        walk = [*COMMAND, "walk", "--forward", "0.08", "--seconds", "60", "--connect", gateway.endpoint]
        walker = Child(walk, os.environ)
        body.wait(lambda each: each.position_m[0] > 0.02, timeout_s=30)
        walker.kill()
        written.wait(lambda frame: frame.cause == Cause.WATCHDOG, count=6)
        walker.close()
        body.wait(fallen_after(body.all[-1]))
    folder = gateway.config.parent
    export = [*COMMAND, "incidents", "export", "last", str(incident), "--config", str(gateway.config)]
    exported = Child(export, {**os.environ, "XDG_RUNTIME_DIR": str(folder)})
    assert exported.wait(20) == 0, str(exported)
    exported.close()
    with gateway.client() as client:
        again = Heard(client, SIM_BODY, BodyReport)
        done = gateway.run("replay", str(incident), timeout_s=40)
        assert done.returncode == 0, str(done)
        stood = again.wait(lambda each: each.position_m[2] > STANDS_M)
        again.wait(fallen_after(stood))


def fallen_after(stood: BodyReport) -> Any:
    """Whether it lies, later than that."""
    return lambda each: each.time > stood.time and each.position_m[2] < LIES_M
