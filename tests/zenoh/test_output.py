"""A command whose standard output cannot be written ends with a sentence, however Python buffers."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from typing import IO, Any, Final
from zlib import compress

import pytest

from gateway import certs
from gateway.model import black_box as form
from gateway.robot.blackbox import ring as rings
from gateway.robot.blackbox.journal import Keyframes
from gateway.robot.blackbox.ring import RecordRing
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import Supervisor
from tests.support.child import Child
from tests.support.command import program
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import COMMAND, Gateway, write_settings
from tests.support.robot import WALL_NS

FAILING: Final = (sys.executable, "-m", "tests.support.failing_output")
WHY: Final = {"full": "No space left on device", "closed": "Broken pipe"}
PERSON: Final = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
PRINTS: Final = (
    "--version", "--help", "stop", "estop", "reset", "send leg 3 stop", "send legs stop", "send servo 32 stop",
    "status", "status --json", "status --follow", "status --follow --json", "walk --seconds 0.1",
    "decode 06 02 20 02 00 00", "decode 06 02 20 02 00 00 --json",
    "calibrate export", "calibrate landing --yes", "calibrate import {folder}/calibration --yes",
    "certs init --host localhost --dir {own}", "certs issue {name} --role observer --dir {certs}",
    "certs renew gateway --dir {certs}", "certs revoke {name} --dir {certs}",
    "certs list --dir {certs}", "certs list --json --dir {certs}",
    "record {own}.mcap --for 0.1", "incidents list --config {config}", "incidents list --json --config {config}",
    "incidents show last --config {config}", "incidents show last --json --config {config}",
    "incidents replay last --config {config}", "incidents replay last --json --config {config}",
    "incidents export last {own}-incident.mcap --config {config}", "check --config {config}",
    "check --json --config {config}",
)  # fmt: skip
SERVES: Final = ("run", "console")  # they go on; tests/unit/test_host.py
PRINTS_NOTHING: Final = {
    "incidents replay last --json --config /nowhere": 2,
    "stop-servos --config /nowhere": 2,
    "setup --dry-run": 2,
    "ros2 --domain -1": 2,
}

gateway = gateway_fixture()


@pytest.fixture(scope="module")
def folder(gateway: Gateway, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with what the commands read: a CA, an incident, a calibration."""
    folder = tmp_path_factory.mktemp("read")
    certs.folder.init(folder / "certs", ["localhost"])
    certs.folder.issue(folder / "certs", "anna", certs.OPERATOR)
    write_settings(folder / "gateway.toml", {"state": {"path": str(folder / "state")}, "spi": {"framing": "plain"}})
    ring = RecordRing(rings.prepare(folder / "state"), 100)
    ring.append(form.KEYFRAME, 1, compress(Keyframes(Supervisor(Rules())).take()))
    ring.append(form.INCIDENT, 5, form.fields(WALL_NS, "20260921-141320-123-watchdog"))
    ring.close()
    (folder / "calibration").write_text(gateway.run("calibrate", "export").stdout)
    return folder


def failing(gateway: Gateway, folder: Path, command: str) -> Iterator[tuple[str, Child]]:
    """Begin a command with each output that fails."""
    environment = {**os.environ, "HEXAPOD_CONNECT": gateway.endpoint}
    for where, buffered in product(WHY, ("yes", "no")):
        name = f"of-{where}-{buffered}"
        own = {"folder": folder, "own": folder / name, "name": name, "config": folder / "gateway.toml"}
        own["certs"] = shutil.copytree(folder / "certs", folder / f"{name}-certs", dirs_exist_ok=True)
        yield where, Child([*FAILING, where, buffered, *command.format(**own).split()], environment)


@pytest.mark.parametrize("command", PRINTS)
def test_an_output_that_fails_is_a_sentence(gateway: Gateway, folder: Path, command: str) -> None:
    with ExitStack() as running:
        for where, child in [(where, running.enter_context(each)) for where, each in failing(gateway, folder, command)]:
            assert child.wait() == 1, str(child)
            assert child.stderr.splitlines()[-1] == f"hexapod-gateway: cannot write the output: {WHY[where]}"
            assert child.stderr.count("cannot write") == 1, str(child)
            assert "Traceback" not in child.stderr


@pytest.mark.parametrize("command", PRINTS_NOTHING)
def test_a_command_without_output_ends_as_ever(gateway: Gateway, folder: Path, command: str) -> None:
    with ExitStack() as running:
        for _, child in [(where, running.enter_context(each)) for where, each in failing(gateway, folder, command)]:
            assert child.wait() == PRINTS_NOTHING[command], child
            assert "cannot write" not in child.stderr


@pytest.mark.parametrize("arguments", ["status --json", "--version"])
@pytest.mark.parametrize("unbuffered", [{}, {"PYTHONUNBUFFERED": "1"}], ids=["buffered", "unbuffered"])
def test_pythons_own_end_adds_nothing(gateway: Gateway, arguments: str, unbuffered: dict[str, str]) -> None:
    environment = {**PERSON, **unbuffered, "HEXAPOD_CONNECT": gateway.endpoint}

    def ended(stdout: IO[str] | int, stderr: IO[str] | int) -> tuple[int, str]:
        command = [*COMMAND, *arguments.split()]
        end = subprocess.run(command, env=environment, stdout=stdout, stderr=stderr, text=True, check=False, timeout=60)
        return end.returncode, end.stderr or ""

    with Path("/dev/full").open("w") as full:
        sentence = f"hexapod-gateway: cannot write the output: {WHY['full']}\n"
        assert ended(full, subprocess.PIPE) == (1, sentence)
        assert ended(subprocess.DEVNULL, full) == (0, "")


def test_the_tables_name_every_command() -> None:
    def leaves(group: Any, above: str = "") -> Iterator[str]:
        for name, each in group.commands.items():
            if hasattr(each, "commands"):
                yield from leaves(each, f"{above}{name} ")
            else:
                yield f"{above}{name}"
                yield from [f"{above}{name} --json"] * any("--json" in option.opts for option in each.params)

    tried = [*PRINTS, *SERVES, *PRINTS_NOTHING]
    missing = [
        name
        for name in leaves(program())
        if not any(
            each.startswith(name.removesuffix(" --json")) and ("--json" in each) >= ("--json" in name) for each in tried
        )
    ]
    assert missing == []
