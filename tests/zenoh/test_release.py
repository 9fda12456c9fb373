"""What is released: built twice, equal to the byte; its wheel in an empty environment is what a laptop gets."""

import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from release.build import ROOT, UV
from release.documents import EXTRAS
from tests.support.child import Child
from tests.support.gateway_process import READY, free_port

pytestmark = pytest.mark.nightly

LEFT_OUT = shutil.ignore_patterns(".git", ".venv", "__pycache__", ".*_cache", "dist", "build", "*.egg-info", "tests")
WHEN = "1700000000"


def released(folder: Path, umask: int, when_touched_s: int) -> dict[str, bytes]:
    """What `make dist` makes of a copy there, without a key."""
    copy = folder / "repository"
    shutil.copytree(ROOT, copy, ignore=LEFT_OUT, symlinks=True)
    for path in copy.rglob("*"):
        os.utime(path, (when_touched_s, when_touched_s), follow_symlinks=False)
    done = subprocess.run(
        [sys.executable, "-m", "release", "--to", str(folder / "dist")],
        cwd=copy,
        env={**os.environ, "SOURCE_DATE_EPOCH": WHEN, "TZ": "Asia/Tokyo" if umask else "UTC"},
        umask=umask,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return {path.name: path.read_bytes() for path in (folder / "dist").iterdir()}


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, bytes], dict[str, bytes]]:
    first, second = tmp_path_factory.mktemp("first"), tmp_path_factory.mktemp("second")
    with ThreadPoolExecutor() as pool:
        begun = pool.submit(released, second / "elsewhere", 0o077, 1_650_000_000)
        return released(first, 0o022, 1_600_000_000), begun.result()


def test_two_builds_are_equal_to_the_byte(twice: tuple[dict[str, bytes], dict[str, bytes]]) -> None:
    first, second = twice
    assert sorted(first) == sorted(second)
    assert [name for name in first if first[name] != second[name]] == []
    with tarfile.open(fileobj=io.BytesIO(next(first[name] for name in first if name.endswith(".tar.gz")))) as archive:
        assert any(name.endswith("/gateway/robot/core/supervisor.py") for name in archive.getnames())
    kinds = sorted(name.rpartition(".")[2] for name in first)
    assert kinds == ["SHA256SUMS", "deb", "deb", "gz", "json", "whl"]


def test_the_wheel_has_both_packages_their_types_the_schemas_the_licence_and_what_a_robot_needs(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {"gateway/py.typed", "schemas/py.typed", "schemas/json/LegCommand.json", "gateway/cli.py"} <= names
    page = ROOT / "gateway/people/console/page"
    assert {str(path.relative_to(ROOT)) for path in page.rglob("*") if path.is_file()} <= names
    assert any(name.endswith("LICENSE") for name in names)
    assert {"gateway/deploy/gateway.toml", "gateway/deploy/systemd/console.conf"} <= names
    assert not [each for each in names if each.startswith(("release/", "tests/"))]


def test_the_sbom_names_every_package_of_the_lock_with_its_hashes(
    twice: tuple[dict[str, bytes], dict[str, bytes]],
) -> None:
    sbom = json.loads(twice[0]["sbom.cdx.json"])
    assert (sbom["bomFormat"], sbom["specVersion"]) == ("CycloneDX", "1.5")
    assert sbom["metadata"]["timestamp"] == "2023-11-14T22:13:20Z"
    export = [UV, "export", "--quiet", "--frozen", "--no-config", "--no-header", "--no-annotate", "--no-emit-project"]
    lock = subprocess.run([*export, *EXTRAS], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    locked = {tuple(line.split(" ")[0].split("==")) for line in lock.splitlines() if not line.startswith(" ")}
    assert locked == {(each["name"], each["version"]) for each in sbom["components"]}
    hashes = {
        item["content"] for each in sbom["components"] for at in each["externalReferences"] for item in at["hashes"]
    }
    in_lock = {part.split("sha256:")[1] for part in lock.split() if "sha256:" in part}
    assert in_lock <= hashes


@pytest.fixture(scope="module")
def wheel(twice: tuple[dict[str, bytes], dict[str, bytes]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the first build."""
    name = next(name for name in twice[0] if name.endswith(".whl"))
    path = tmp_path_factory.mktemp("wheel") / name
    path.write_bytes(twice[0][name])
    return path


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with nothing but the wheel and what it depends on; no SPI, no compiler."""
    folder = tmp_path_factory.mktemp("empty")
    subprocess.run([UV, "venv", "--quiet", "--seed", "--python", sys.executable, folder / "venv"], check=True)
    python = folder / "venv" / "bin" / "python"
    install = [UV, "pip", "install", "--quiet", "--only-binary=:all:", "--python", str(python), str(wheel)]
    subprocess.run(install, check=True, env={**os.environ, "CC": "/bin/false"})
    return python


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
