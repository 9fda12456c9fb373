"""What an import loads: nothing slow before a Stop, no extra's package unasked, nothing that only Linux has."""

import json
import os
import re
import signal
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path
from typing import Final

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.support.child import Child
from tests.support.command import run_program
from tests.support.fixtures import gateway_fixture, patient
from tests.support.gateway_process import Gateway, free_port

PROJECT: Final = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
NEED_AN_EXTRA: Final = {
    **{f"gateway.people.ros2.{name}": "rclpy" for name in ("node", "run", "topics")},
    "gateway.people.console": "console",
    "gateway.people.physics": "physics",
    "gateway.people.recorder.record": "record",
    "gateway.people.watching.camera": "console",
    "gateway.onboard.simulation_process": "physics",
    "gateway.robot.power.slcan": "power",
}
"""Modules that other modules load only where a person asks for what the extra is for."""

IMPORT_ALL: Final = """
import importlib.machinery, json, pkgutil, sys
blocked = set(json.loads(sys.argv[1]))
class Installed(importlib.machinery.PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] in blocked else super().find_spec(name, path, target)
sys.meta_path[sys.meta_path.index(importlib.machinery.PathFinder)] = Installed
import gateway
failed = []
for module in pkgutil.walk_packages(gateway.__path__, "gateway.", onerror=lambda name: None):
    if not module.name.endswith("__main__"):
        try:
            importlib.import_module(module.name)
        except Exception:
            failed.append(module.name)
print(json.dumps(failed))
"""

STOP_SERVOS: Final = """
from gateway.__main__ import main
sys.argv = ["hexapod-gateway", "stop-servos", "--config", "gateway.toml"]
try:
    main()
except SystemExit as end:
    assert end.code == 3, end.code
"""
FIRST_STOPS: Final = """
from gateway.robot.spi import stop_all
from gateway.__main__ import main
class FirstStops(BaseException): pass
def stop_once(bus):
    raise FirstStops
stop_all.stop_once = stop_once
sys.argv = ["hexapod-gateway", "run", "--config", "gateway.toml"]
try:
    main()
except FirstStops:
    pass
else:
    raise AssertionError("no Stop")
"""
SLOW: Final = "asyncio gateway.cli logging pydantic pydantic_core typer zenoh"
SERVICE: Final = "import gateway.cli, gateway.onboard.serve, gateway.robot.service"
SCHEMAS: Final = """
import importlib, pkgutil, pydantic, schemas
for module in pkgutil.iter_modules(schemas.__path__, "schemas."):
    importlib.import_module(module.name)
"""


def loaded(code: str, folder: Path) -> set[str]:
    """Return the modules that this loads in a Python of its own."""
    program = f"import sys\nbefore = set(sys.modules)\n{code}\nprint(*set(sys.modules) - before)"
    return set(run_program(sys.executable, "-c", program, cwd=folder).stdout.split())


@pytest.mark.parametrize(
    ("code", "late"),
    [
        ("import gateway.people.commands.send", "asyncio cryptography schemas.lease"),
        # Of the 0.33 s of processor time that it took with these, 0.07 s are left.
        (STOP_SERVOS, SLOW),
        # Of 0.40 s, 0.09 s are left.
        (FIRST_STOPS, SLOW),
        (SERVICE, "gateway.simulation.controller gateway.simulation.elkapod prometheus_client rich textual"),
    ],
    ids=["a laptop's Stop", "stop-servos", "the service's first Stops", "the service"],
)
def test_nothing_slow_is_loaded_before_the_stops(code: str, late: str, tmp_path: Path) -> None:
    (tmp_path / "gateway.toml").write_text('spi.framing = "plain"\nspi.device = "/dev/none"\n')
    assert loaded(code, tmp_path) & set(late.split()) == set()


def test_a_payload_needs_nothing_but_pydantic(tmp_path: Path) -> None:
    roots = {name.partition(".")[0] for name in loaded(SCHEMAS, tmp_path)} - sys.stdlib_module_names
    # The standard library's own configuration is named after the machine. The last four are parts of pydantic.
    ours = {"schemas", "pydantic", "pydantic_core", "annotated_types", "typing_inspection", "typing_extensions"}
    assert {name for name in roots if not name.startswith("_sysconfigdata_")} <= ours


def _with_theirs(names: set[str]) -> set[str]:
    """Return these distributions and all that they need."""
    found: set[str] = set()
    pending = set(names)
    while pending:
        found.add(name := pending.pop())
        try:
            needed = requires(name) or []
        except PackageNotFoundError:
            continue
        pending |= {canonicalize_name(Requirement(each).name) for each in needed if "extra ==" not in each} - found
    return found


def test_a_plain_installation_imports_all_but_what_an_extra_is_for() -> None:
    plain = _with_theirs({canonicalize_name(Requirement(each).name) for each in PROJECT["dependencies"]})
    blocked = [
        module
        for module, distributions in packages_distributions().items()
        if not {*map(canonicalize_name, distributions)} & (plain | {PROJECT["name"]})
        and module not in sys.stdlib_module_names
    ]
    ran = run_program(sys.executable, "-c", IMPORT_ALL, json.dumps(blocked))
    failed = [name for name in json.loads(ran.stdout) if not name.startswith(tuple(NEED_AN_EXTRA))]
    assert failed == []


# ---- client and commands on macOS and Windows: without what only POSIX or Linux has


gateway = gateway_fixture(patient(4000, lease={"ttl_ms": 10_000}))

PROGRAM = """
import asyncio
from tests.support import elsewhere
elsewhere.forget()
from gateway.client import AsyncClient, Client
POSE = [(90, 45, 120)] * 6
with Client({endpoint!r}) as robot:
    robot.wait_ready()
    with robot.lease(), robot.stream(20) as stream:
        stream.set(POSE)
        stream.set(POSE)
async def walks():
    async with AsyncClient({endpoint!r}) as robot, robot.walk() as walk:
        await walk.stand()
asyncio.run(walks())
print("done")
"""


def elsewhere(*arguments: str, **environment: str) -> Child:
    command = [sys.executable, "-m", "tests.support.elsewhere", "gateway", *arguments]
    return Child(command, {**os.environ, **environment})


def test_a_program_runs_without_what_only_linux_has(gateway: Gateway) -> None:
    child = Child([sys.executable, "-c", PROGRAM.format(endpoint=gateway.endpoint)], os.environ)
    assert child.wait(60) == 0, child.stderr
    child.close()
    assert child.stdout == "done\n"


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("send", "legs", "start", "90", "45", "120"), 0, "accepted"),
        (("stop",), 0, "all six legs are stopped"),
        (("status",), 0, "No servo runs"),
        (("walk", "--forward", "0.05", "--seconds", "0.2"), 0, "walked 0.0"),
        (("walk",), 1, "needs a Unix terminal; on Windows, run it in WSL, or use --seconds"),
    ],
    ids=["send", "stop", "status", "walk", "walk by keys"],
)
def test_a_command_runs_without_what_only_linux_has(
    gateway: Gateway, arguments: tuple[str, ...], code: int, said: str
) -> None:
    child = elsewhere(*arguments, "--connect", gateway.endpoint)
    assert child.wait(60) == code, child.stderr
    child.close()
    assert said in child.stdout + child.stderr
    assert "Traceback" not in child.stderr


@pytest.mark.parametrize(
    ("arguments", "begun"),
    [
        ("status --follow", "No servo runs"),
        ("record {folder}/ride.mcap", "recording into"),
        ("console --listen 127.0.0.1:{port}", "The console is at http://"),
    ],
    ids=["status", "record", "console"],
)
def test_a_command_that_goes_on_until_ctrl_c(gateway: Gateway, tmp_path: Path, arguments: str, begun: str) -> None:
    name, *given = arguments.format(folder=tmp_path, port=free_port()).split()
    state = {"XDG_STATE_HOME": str(tmp_path)}
    with elsewhere(name, *given, "--connect", gateway.endpoint, **state) as child:
        child.wait_for_output(begun, timeout_s=60)
        if name == "console":
            with elsewhere(name, "--link", *given, **state) as link:
                assert link.wait(60) == 0, link.stderr
            assert re.search(r"The console is at http://127\.0\.0\.1:\d+/\?token=", link.stdout)
        child.send_signal(signal.SIGINT)
        assert child.wait(60) == 0, child.stderr
    assert "Traceback" not in child.stderr
    assert (tmp_path / "ride.mcap").exists() == (name == "record")
