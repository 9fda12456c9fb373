"""What is released: locked, built twice and equal to the byte; and the command of docs/robot.md for a download."""

import io
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from release.build import ROOT, UV, plain
from release.documents import EXTRAS, SUMS, sign, write_sums
from tests.support.command import run_program

LEFT_OUT = shutil.ignore_patterns(".git", ".venv", "__pycache__", ".*_cache", "dist", "build", "*.egg-info", "tests")
WHEN = "1700000000"
OFFERED = re.compile(r"^([A-Za-z0-9_.-]+)")


Twice = tuple[dict[str, bytes], dict[str, bytes]]
"""By name, the files that each of two builds has made."""


def released(folder: Path, umask: int, when_touched_s: int) -> dict[str, bytes]:
    """Return what `make dist` makes of a copy there, without a key."""
    copy = folder / "repository"
    shutil.copytree(ROOT, copy, ignore=LEFT_OUT, symlinks=True)
    for path in copy.rglob("*"):
        os.utime(path, (when_touched_s, when_touched_s), follow_symlinks=False)
    env = {**os.environ, "SOURCE_DATE_EPOCH": WHEN, "TZ": "Asia/Tokyo" if umask else "UTC"}
    run_program(sys.executable, "-m", "release", "--to", folder / "dist", cwd=copy, env=env, umask=umask)
    return {path.name: path.read_bytes() for path in (folder / "dist").iterdir()}


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> Twice:
    first, second = tmp_path_factory.mktemp("first"), tmp_path_factory.mktemp("second")
    with ThreadPoolExecutor() as pool:
        begun = pool.submit(released, second / "elsewhere", 0o077, 1_650_000_000)
        return released(first, 0o022, 1_600_000_000), begun.result()


@pytest.mark.nightly
def test_two_builds_are_equal_to_the_byte(twice: Twice) -> None:
    first, second = twice
    assert sorted(first) == sorted(second)
    assert [name for name in first if first[name] != second[name]] == []
    with tarfile.open(fileobj=io.BytesIO(next(first[name] for name in first if name.endswith(".tar.gz")))) as archive:
        assert any(name.endswith("/gateway/robot/core/supervisor.py") for name in archive.getnames())
    kinds = sorted(name.rpartition(".")[2] for name in first)
    assert kinds == ["SHA256SUMS", "deb", "deb", "gz", "json", "whl"]


@pytest.mark.nightly
def test_the_wheel_has_both_packages_the_licence_and_what_a_robot_needs(twice: Twice) -> None:
    (wheel,) = (data for name, data in twice[0].items() if name.endswith(".whl"))
    names = set(zipfile.ZipFile(io.BytesIO(wheel)).namelist())
    assert {"gateway/py.typed", "schemas/py.typed", "schemas/json/LegCommand.json", "gateway/cli.py"} <= names
    page = ROOT / "gateway/people/console/page"
    assert {str(path.relative_to(ROOT)) for path in page.rglob("*") if path.is_file()} <= names
    assert any(name.endswith("LICENSE") for name in names)
    assert {"gateway/deploy/gateway.toml", "gateway/deploy/systemd/console.conf"} <= names
    assert not [each for each in names if each.startswith(("release/", "tests/"))]


@pytest.mark.nightly
def test_the_sbom_names_every_package_of_the_lock_with_its_hashes(twice: Twice) -> None:
    sbom = json.loads(twice[0]["sbom.cdx.json"])
    assert (sbom["bomFormat"], sbom["specVersion"]) == ("CycloneDX", "1.5")
    assert sbom["metadata"]["timestamp"] == "2023-11-14T22:13:20Z"
    export = [UV, "export", "--quiet", "--frozen", "--no-config", "--no-header", "--no-annotate", "--no-emit-project"]
    lock = run_program(*export, *EXTRAS, cwd=ROOT).stdout
    locked = {tuple(line.split(" ")[0].split("==")) for line in lock.splitlines() if not line.startswith(" ")}
    assert locked == {(each["name"], each["version"]) for each in sbom["components"]}
    hashes = {
        item["content"] for each in sbom["components"] for at in each["externalReferences"] for item in at["hashes"]
    }
    in_lock = {part.split("sha256:")[1] for part in lock.split() if "sha256:" in part}
    assert in_lock <= hashes


def test_the_lock_has_every_dependency_with_its_hashes() -> None:
    """After a change of pyproject.toml: `make lock`."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    optional = project["optional-dependencies"]
    wanted = [*project["dependencies"], *optional["spi"], *optional["console"], *optional["power"]]
    names = {match[1].lower().replace("_", "-") for each in wanted if (match := OFFERED.match(each)) is not None}
    locked = {each["name"]: each for each in tomllib.loads((ROOT / "uv.lock").read_text())["package"]}
    assert names <= locked.keys()
    for name in names:
        files = [*locked[name].get("wheels", []), *([locked[name]["sdist"]] if "sdist" in locked[name] else [])]
        assert files
        assert all(re.fullmatch("sha256:[0-9a-f]{64}", each["hash"]) for each in files), name


def test_an_archive_says_nothing_of_the_machine(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).write_text(name)
    (tmp_path / "a").chmod(0o750)
    made: list[bytes] = []
    for order in ("ab", "ba"):
        written = io.BytesIO()
        with tarfile.open(fileobj=written, mode="w:gz") as machines:
            for name in order:
                os.utime(tmp_path / name, (len(made), len(made)))
                machines.add(tmp_path / name, name)
        made.append(plain(written.getvalue(), 1_700_000_000))
    assert made[0] == made[1]
    with tarfile.open(fileobj=io.BytesIO(made[0])) as archive:
        entries = archive.getmembers()
    assert [(each.name, each.mode) for each in entries] == [("a", 0o755), ("b", 0o644)]
    assert {(each.mtime, each.uid, each.gid, each.uname) for each in entries} == {(1_700_000_000, 0, 0, "")}


PACKAGE = "hexapod-gateway_1.1.0_arm64.deb"


@pytest.fixture
def download(tmp_path: Path) -> Path:
    """Return a package with the sums and the signature of a release that has more files."""
    key = tmp_path / "key"
    run_program("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", key)
    folder = tmp_path / "download"
    folder.mkdir()
    for name in (PACKAGE, "other"):
        (folder / name).write_bytes(name.encode())
    write_sums(folder, [folder / "other", folder / PACKAGE])
    sign(folder, key)
    (folder / "other").unlink()
    return folder


def check(folder: Path) -> tuple[bool, str]:
    """Run the page's command there. Return whether all is well, and its output."""
    found = re.search(r"`(ssh-keygen -Y .*)`", (ROOT / "docs" / "robot.md").read_text())
    assert found is not None
    done = subprocess.run(["bash", "-c", found[1]], cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode == 0, done.stdout + done.stderr


def test_the_command_of_the_readme(download: Path) -> None:
    shown = run_program("ssh-keygen", "-lf", download.parent / "key").stdout
    ok, said = check(download)
    assert ok, said
    assert f'Good "hexapod-gateway-release" signature with ED25519 key {shown.split()[1]}' in said
    assert f"{PACKAGE}: OK" in said
    assert [line.split()[1] for line in (download / SUMS).read_text().splitlines()] == [PACKAGE, "other"], "in order"

    (download / PACKAGE).write_bytes(b"changed")
    ok, said = check(download)
    assert not ok
    assert f"{PACKAGE}: FAILED" in said
    write_sums(download, [download / PACKAGE])
    ok, said = check(download)
    assert not ok
    assert "Signature verification failed" in said or "incorrect signature" in said
    (download / f"{SUMS}.sig").unlink()
    assert not check(download)[0]
