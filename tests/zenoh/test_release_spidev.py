"""The spidev wheel of a bundle: the same bytes wherever it is compiled, and one for each Python of a robot."""

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from release import spidev
from release.build import ROOT

pytestmark = pytest.mark.nightly

WHEN = 1_700_000_000
THIS = f"{sys.version_info.major}.{sys.version_info.minor}"
AARCH64 = 183  # e_machine of an ELF file


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """spidev's sources, with the hash of the lock."""
    folder = tmp_path_factory.mktemp("sdist")
    only = subprocess.run(
        ["bash", "-c", ". deploy/spidev.sh && only_spidev <deploy/lock/requirements.txt"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert only.startswith("spidev==")
    (folder / "only.txt").write_text(only)
    pip = [
        sys.executable,
        "-m",
        "pip",
        "download",
        "--quiet",
        "--dest",
        str(folder),
        "--no-deps",
    ]
    subprocess.run([*pip, "--no-binary", "spidev", "--require-hashes", "-r", str(folder / "only.txt")], check=True)
    return next(folder.glob("spidev-*.tar.gz"))


def here(sdist: Path) -> tuple[str, bytes]:
    """As for a robot, but by this machine's compiler and with its headers."""
    return spidev.wheel(sdist, THIS, [Path(sysconfig.get_path("include"))], "gcc", WHEN)


def test_two_builds_are_equal_to_the_byte_and_can_be_imported(
    sdist: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = here(sdist)
    other = tmp_path / "another folder for what is temporary"
    other.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(other))
    monkeypatch.setenv("TZ", "Asia/Tokyo")
    sources = shutil.copytree(sysconfig.get_path("include"), tmp_path / "include")
    before = os.umask(0o077)
    try:
        second = spidev.wheel(sdist, THIS, [sources], "gcc", WHEN)
    finally:
        os.umask(before)
    assert first == second
    (tmp_path / first[0]).write_bytes(first[1])
    with zipfile.ZipFile(tmp_path / first[0]) as wheel:
        assert wheel.testzip() is None
        module = next(name for name in wheel.namelist() if name.endswith(".so"))
        (tmp_path / "spidev.so").write_bytes(wheel.read(module))
        assert f"Tag: cp{THIS.replace('.', '')}-" in wheel.read(f"{first[0].split('-cp')[0]}.dist-info/WHEEL").decode()
    code = "import spidev; print(spidev.__file__, spidev.SpiDev().fileno())"
    said = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert said == f"{tmp_path / 'spidev.so'} -1\n"


@pytest.mark.parametrize("version", spidev.SUITES)
def test_each_python_of_a_robot_gets_one(
    sdist: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, version: str
) -> None:
    lack = spidev.lacks()
    if lack and os.environ.get("CI") != "true":
        pytest.skip(lack)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", str(WHEN))
    assert spidev.main(str(tmp_path), str(sdist), version) == 0, lack
    (made,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(made) as wheel:
        (module,) = (wheel.read(name) for name in wheel.namelist() if name.endswith(".so"))
    assert int.from_bytes(module[18:20], "little") == AARCH64
    assert str(ROOT).encode() not in module
    options = (
        "--no-deps",
        "--no-index",
        "--only-binary=:all:",
        "--platform",
        "linux_aarch64",
        "--python-version",
        version,
    )
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--target", str(tmp_path / "robot")]
    subprocess.run([*pip, *options, str(made)], check=True)
    assert next((tmp_path / "robot").glob("spidev.*.so")).read_bytes() == module
