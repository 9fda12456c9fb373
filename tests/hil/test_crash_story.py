"""After SIGKILL: what the next gateway's black box says of the Stops between."""

from pathlib import Path

import pytest

from gateway.client import Client
from tests.hil.bed import SpiTestbed
from tests.hil.wire import LATE_S
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, READY, free_port, write_settings

pytestmark = pytest.mark.hil


def test_a_crash_story_says_when_stop_servos_wrote(tmp_path: Path, spi_testbed: SpiTestbed) -> None:
    """As systemd runs it after an end, with the service's runtime directory."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    (tmp_path / "run").mkdir()
    env = {"RUNTIME_DIRECTORY": str(tmp_path / "run")}
    sections: dict[str, dict[str, object]] = {
        "zenoh": {"listen": [endpoint]},
        "spi": {"framing": "plain"},
        "recorder": {"path": str(tmp_path / "box")},
    }
    config = write_settings(tmp_path / "gateway.toml", sections)

    def spawn(*arguments: str) -> Child:
        return spi_testbed.spawn([*COMMAND, *arguments, "--config", str(config)], env=env)

    gateway = spawn("run")
    gateway.wait_for_output(READY, LATE_S)
    with Client(endpoint, source="hil", timeout_s=5) as client:
        assert client.start_leg(3, 90, 45, 120).accepted
        gateway.kill()
    stop = spawn("stop-servos")
    assert stop.wait(LATE_S) == 0, str(stop)
    again = spawn("run")
    again.wait_for_output(READY, LATE_S)
    shown = spawn("incidents", "show", "last")
    assert shown.wait(LATE_S) == 0, str(shown)
    again.terminate()
    assert again.wait(LATE_S) == 0
    for child in (gateway, stop, again, shown):
        child.close()
    lines = shown.stdout.splitlines()
    killed, written, started = (
        max(place for place, line in enumerate(lines) if text in line)
        for text in (
            "ended without a word",
            "stop-servos has written a Stop to each of the six legs",
            "a gateway starts",
        )
    )
    assert killed < written < started, shown.stdout
    assert not (tmp_path / "run" / "stop-servos").exists(), "the next start is told of its own"
