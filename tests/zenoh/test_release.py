"""Built twice, in different folders, at different times, under another umask: equal to the byte."""

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from release.build import ROOT

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
    return released(first, 0o022, 1_600_000_000), released(second / "elsewhere", 0o077, 1_650_000_000)


def test_two_builds_are_equal_to_the_byte(twice: tuple[dict[str, bytes], dict[str, bytes]]) -> None:
    first, second = twice
    assert sorted(first) == sorted(second)
    assert [name for name in first if first[name] != second[name]] == []
    kinds = {name.rpartition(".")[2] for name in first}
    assert {"whl", "gz", "toml", "txt", "json", "SHA256SUMS"} <= kinds


def test_the_wheel_has_what_a_robot_needs(twice: tuple[dict[str, bytes], dict[str, bytes]], tmp_path: Path) -> None:
    name = next(name for name in twice[0] if name.endswith(".whl"))
    (tmp_path / name).write_bytes(twice[0][name])
    with zipfile.ZipFile(tmp_path / name) as wheel:
        packed = set(wheel.namelist())
    deploy = ROOT / "deploy"
    assert {f"gateway/deploy/{path.relative_to(deploy)}" for path in deploy.rglob("*") if path.is_file()} <= packed
    assert not [each for each in packed if each.startswith(("release/", "tests/"))]


def test_the_sbom_names_every_package_of_the_lock_with_its_hashes(
    twice: tuple[dict[str, bytes], dict[str, bytes]],
) -> None:
    sbom = json.loads(twice[0]["sbom.cdx.json"])
    assert (sbom["bomFormat"], sbom["specVersion"]) == ("CycloneDX", "1.5")
    assert sbom["metadata"]["timestamp"] == "2023-11-14T22:13:20Z"
    lock = (ROOT / "deploy" / "lock" / "requirements.txt").read_text()
    locked = {tuple(line.split(" ")[0].split("==")) for line in lock.splitlines() if not line.startswith(" ")}
    assert locked == {(each["name"], each["version"]) for each in sbom["components"]}
    hashes = {
        item["content"] for each in sbom["components"] for at in each["externalReferences"] for item in at["hashes"]
    }
    in_lock = {part.split("sha256:")[1] for part in lock.split() if "sha256:" in part}
    assert in_lock <= hashes
