"""The wheel in an empty environment: what a laptop gets."""

import json
import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.support.child import Child
from tests.support.gateway_process import READY, free_port

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel and a source archive, built from a copy without what lies around in a working folder."""
    folder = tmp_path_factory.mktemp("build")
    names = ("pyproject.toml", "README.md", "LICENSE", "gateway", "schemas")
    subprocess.run(["cp", "-rL", *(REPOSITORY / name for name in names), folder], check=True)
    subprocess.run(
        [sys.executable, "-m", "build", "--outdir", folder / "dist", folder], check=True, capture_output=True
    )
    return folder / "dist"


@pytest.fixture(scope="module")
def python(dist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with nothing but the wheel and what it depends on; no SPI, no compiler."""
    folder = tmp_path_factory.mktemp("empty")
    subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)
    python = folder / "venv" / "bin" / "python"
    (wheel,) = dist.glob("*.whl")
    environment = {**os.environ, "CC": "/bin/false"}
    subprocess.run(
        [python, "-m", "pip", "install", "--quiet", "--only-binary=:all:", wheel], check=True, env=environment
    )
    return python


def test_the_wheel_holds_both_packages_their_types_the_schemas_and_the_licence(dist: Path) -> None:
    (wheel,) = dist.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    for name in ("gateway/py.typed", "schemas/py.typed", "schemas/json/LegCommand.json", "gateway/cli.py"):
        assert name in names
    page = REPOSITORY / "gateway/people/console/page"
    assert {str(path.relative_to(REPOSITORY)) for path in page.rglob("*") if path.is_file()} <= set(names)
    assert any(name.endswith("LICENSE") for name in names)
    assert not any(name.startswith("tests") for name in names)
    (source,) = dist.glob("*.tar.gz")
    with tarfile.open(source) as archive:
        assert any(name.endswith("/gateway/robot/core/supervisor.py") for name in archive.getnames())


def test_it_runs_where_nothing_else_is_installed(python: Path, tmp_path: Path) -> None:
    program = python.with_name("hexapod-gateway")
    said = subprocess.run([program, "--help"], check=True, capture_output=True, text=True, cwd=tmp_path).stdout
    assert "Usage: hexapod-gateway" in said
    decoded = subprocess.run([program, "decode", "060220020000"], capture_output=True, text=True, check=True)
    assert "servo 32 stop" in decoded.stdout
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    environment = {**os.environ, "HEXAPOD_ZENOH__LISTEN": json.dumps([endpoint])}
    gateway = Child([str(program), "run", "--sim"], environment, tmp_path)
    try:
        gateway.wait_for_output(READY, timeout_s=30)
        sent = subprocess.run(
            [program, "send", "leg", "3", "start", "1", "2", "3", "--connect", endpoint, "--timeout", "10"],
            capture_output=True,
            text=True,
            check=False,
        )
        assert (sent.returncode, sent.stdout) == (0, "accepted\n"), sent.stderr
        gateway.terminate()
        assert gateway.wait() == 0
    finally:
        gateway.close()


def test_the_console_says_what_it_lacks(python: Path) -> None:
    """In one line, and what to install."""
    said = subprocess.run([python, "-m", "gateway", "console"], check=False, capture_output=True, text=True)
    assert said.returncode == 2
    assert said.stderr == (
        "hexapod-gateway: the console needs websockets, segno: pip install 'hexapod-gateway[console]'\n"
    )


def test_schemas_needs_neither_zenoh_nor_spidev(python: Path, tmp_path: Path) -> None:
    code = (
        "import sys\n"
        "before = set(sys.modules)\n"
        "import schemas.keys, schemas.command, schemas.telemetry\n"
        "allowed = {'schemas', 'pydantic', 'pydantic_core', 'annotated_types', 'typing_extensions'}\n"
        "allowed |= {'typing_inspection'}\n"
        "roots = {name.partition('.')[0] for name in sys.modules.keys() - before if not name.startswith('_')}\n"
        "print(sorted(roots - allowed - set(sys.stdlib_module_names)))\n"
    )
    said = subprocess.run([python, "-I", "-c", code], check=True, capture_output=True, text=True, cwd=tmp_path)
    assert said.stdout == "[]\n"


OWN_WHEEL = """
import sys
from pathlib import Path
from gateway.people.tools.install_service import own_wheel
print(own_wheel(Path(sys.argv[1])))
"""


def test_the_installer_is_in_it_and_installs_what_is_installed(python: Path, tmp_path: Path) -> None:
    """`install-service` without a repository: a wheel of the installed files, which is what the service then runs."""
    program = python.with_name("hexapod-gateway")
    shown = subprocess.run([program, "install-service", "--help"], capture_output=True, text=True, check=True)
    assert "--bundle FILE" in shown.stdout
    made = subprocess.run(
        [python, "-c", OWN_WHEEL, tmp_path], cwd=tmp_path, capture_output=True, text=True, check=True
    )  # where no gateway is but the installed one
    target = tmp_path / "target"
    options = ("--quiet", "--no-deps", "--no-index", "--target", target)
    subprocess.run([python, "-m", "pip", "install", *options, made.stdout.strip()], check=True)
    installed = next(python.parents[1].glob("lib/python*/site-packages"))
    for package in ("gateway", "schemas"):
        files = {path.relative_to(installed) for path in (installed / package).rglob("*") if path.is_file()}
        files = {path for path in files if "__pycache__" not in path.parts}
        assert files == {
            path.relative_to(target)
            for path in (target / package).rglob("*")
            if path.is_file() and "__pycache__" not in path.parts
        }
        assert all((installed / path).read_bytes() == (target / path).read_bytes() for path in files)
    assert Path("gateway/deploy/lock/requirements.txt") in {
        path.relative_to(target) for path in (target / "gateway" / "deploy").rglob("*")
    }
