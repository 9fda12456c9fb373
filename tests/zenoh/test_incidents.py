"""`hexapod-gateway incidents` beside a real gateway: while it runs, and after it was killed."""

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from schemas import keys
from tests.support.command import run_here
from tests.support.gateway_process import Gateway
from tests.support.heard import events
from tests.support.mcap_file import read

LEG_3 = keys.leg_command(3)


@pytest.fixture
def gateway(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Gateway]:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with Gateway(tmp_path, {"state": {"path": str(tmp_path / "box")}}) as gateway:
        yield gateway


def incidents(gateway: Gateway, *arguments: str) -> tuple[int, list[str]]:
    """Run it with this gateway's configuration; its exit code and what it printed."""
    done = run_here("incidents", *arguments, "--config", str(gateway.config))
    return done.returncode, done.stdout.splitlines()


def test_a_stop_is_reported_at_once_and_a_killed_gateways_story_is_still_there(
    gateway: Gateway, tmp_path: Path
) -> None:
    with gateway.client(source="anna") as client:
        heard = events(client)
        assert client.start_leg(3, 90, 45, 120).accepted
        assert client.estop().accepted
        name = client.state().incident
        assert name is not None
        assert name.endswith("-estop")
        heard.wait(lambda event: (event.kind, event.incident) == ("estop_engaged", name))
    code, lines = incidents(gateway, "show", "last")
    assert code == 0
    assert lines[0].startswith(f"{name}: somebody requested an emergency stop (anna), at ")
    assert any("last command of leg 3 (anna, start 90 45 120)" in line for line in lines)
    assert any("Stop written to all legs (estop)" in line for line in lines)

    os.kill(gateway.child.pid, signal.SIGKILL)
    gateway.child.wait(10)
    assert "ended without a word" in incidents(gateway, "show", name)[1][-1]
    file = tmp_path / "stop.mcap"
    assert incidents(gateway, "export", "last", str(file)) == (0, [f"{name} is in {file}"])
    told = incidents(gateway, "show", name)[1]
    assert json.loads("\n".join(incidents(gateway, "show", name, "--json")[1])) == {"id": name, "story": told}
    (listed,) = json.loads("\n".join(incidents(gateway, "list", "--json")[1]))
    assert listed["id"] == name
    frames = [message.content for message in read(file) if message.topic == keys.FRAME]
    assert [frame["cause"] for frame in frames if frame["cause"] != "repeat"] == [
        *["startup"] * 6, "command", *["estop"] * 6,
    ]  # fmt: skip
    assert incidents(gateway, "export", "last", str(file))[0] == 2, "it exists"
    assert incidents(gateway, "show", "yesterday")[0] == 1
    assert incidents(gateway, "show", "20200101-000000-000-estop")[0] == 1
