"""deploy/container: the script that a container starts, as PID 1 of a namespace, and the limits that it is given."""

import os
import re
import signal
import sys
from pathlib import Path

import pytest

from tests.support.child import Child
from tests.support.gateway_process import READY, free_port, write_settings

DEPLOY = Path(__file__).parents[2] / "deploy"
SCRIPT = DEPLOY / "container/run-and-stop"


def setting(unit: str, name: str) -> str:
    found = re.search(rf"^{name}=(.*)$", unit, re.MULTILINE)
    assert found is not None
    return found[1]


def test_a_container_gets_the_units_devices_groups_and_limits() -> None:
    unit, page = ((DEPLOY / each).read_text() for each in ("systemd/hexapod-gateway.service", "container/README.md"))
    limits = {
        "--ulimit rtprio=": setting(unit, "LimitRTPRIO"),
        "--ulimit nice=": str(20 - int(setting(unit, "LimitNICE"))),
        "--ulimit nofile=": setting(unit, "LimitNOFILE"),
        "--ulimit core=": setting(unit, "LimitCORE"),
        "--memory ": setting(unit, "MemoryMax").lower(),
        "--pids-limit ": setting(unit, "TasksMax"),
        "--stop-timeout ": setting(unit, "TimeoutStopSec"),
    }
    for option, value in limits.items():
        assert re.search(rf"{option}{value}(\s|$)", page), (option, value)
    for group in setting(unit, "SupplementaryGroups").split():
        assert f"getent group {group} " in page


@pytest.mark.full
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT], ids=["stop", "Ctrl-C"])
def test_as_the_first_process_it_ends_in_time_with_the_gateways_code(tmp_path: Path, number: signal.Signals) -> None:
    config = write_settings(tmp_path / "gateway.toml", {"zenoh": {"listen": [f"tcp/127.0.0.1:{free_port()}"]}})
    with _container(tmp_path, "--sim", "--config", str(config)) as child:
        child.wait_for_output(READY, timeout_s=60)
        children = Path(f"/proc/{child.pid}/task/{child.pid}/children").read_text()
        os.kill(int(children.split()[0]), number)
        assert child.wait() == 0


@pytest.mark.full
def test_whatever_the_end_stops_follow(tmp_path: Path) -> None:
    """Here there is no device, so both say so; the code is the gateway's."""
    config = write_settings(tmp_path / "gateway.toml", {"spi": {"framing": "plain", "device": "/dev/spidev9.9"}})
    with _container(tmp_path, "--config", str(config)) as child:
        assert child.wait() == 3
        assert child.stderr.count("/dev/spidev9.9 does not exist") == 2, child.stderr


def _container(folder: Path, *arguments: str) -> Child:
    """Run the script in a namespace of processes of its own."""
    program = folder / "bin/hexapod-gateway"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m gateway "$@"\n')
    program.chmod(0o755)
    runtime = folder / "run"
    runtime.mkdir()
    environment = {**os.environ, "RUNTIME_DIRECTORY": str(runtime), "PATH": f"{program.parent}:{os.environ['PATH']}"}
    return Child(["unshare", "--pid", "--fork", "--mount-proc", str(SCRIPT), *arguments], environment)
