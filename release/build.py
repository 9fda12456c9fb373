"""Wheel and sdist, equal to the byte wherever and whenever they are built from the same commit.

The build reads a copy of the sources with the commit's time and plain modes, and uses the setuptools of the lock. With
SOURCE_DATE_EPOCH it writes such a wheel by itself. The sdist's members have owners and times of the machine, so its
archive is written anew.
"""

import gzip
import io
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
UV = str(Path(sys.executable).with_name("uv"))
"""The uv of the same environment."""
_GIT = ["git", "-c", f"safe.directory={ROOT}", "-C", str(ROOT)]
"""git in this repository, which may be another user's."""
_VERSION = re.compile(r'^__version__ = "(.*)"$', re.MULTILINE)
_SOURCES = ("pyproject.toml", "setup.py", "README.md", "LICENSE", "gateway", "schemas")


def version() -> str:
    """Return the release, with the commit unless that has its tag: 1.1.0+g4aa0d07, or 1.1.0+g4aa0d07.changed.

    Three commits with one version would look alike on a robot. Without git it stays 1.1.0.
    """
    found = _VERSION.search((ROOT / "gateway/__init__.py").read_text())
    if found is None:
        raise SystemExit("gateway/__init__.py has no __version__")
    commit = _git("rev-parse", "--short=7", "HEAD")
    changed = _git("status", "--porcelain", "--", "pyproject.toml", "setup.py", "deploy", "gateway", "schemas")
    if not commit or (not changed and f"v{found[1]}" in _git("tag", "--points-at", "HEAD").splitlines()):
        return found[1]
    return f"{found[1]}+g{commit}{'.changed' if changed else ''}"


def epoch() -> int:
    """Return SOURCE_DATE_EPOCH, or when the commit was made (s since 1970); without git, now."""
    return int(os.environ.get("SOURCE_DATE_EPOCH") or _git("log", "-1", "--format=%ct") or time.time())


def build(folder: Path, released: str, when: int) -> list[Path]:
    """Build wheel and sdist into `folder`. Return their paths."""
    environment = {**os.environ, "SOURCE_DATE_EPOCH": str(when)}
    with tempfile.TemporaryDirectory() as temporary:
        sources, made = Path(temporary) / "sources", Path(temporary) / "made"
        _copy_sources(sources, released, when)
        command = [UV, "build", "--quiet", "--no-config", "--require-hashes", "--build-constraints"]
        lock = ROOT / "release" / "build.txt"
        run([*command, str(lock), "--out-dir", str(made), str(sources)], environment)
        wheel, sdist = next(made.glob("*.whl")), next(made.glob("*.tar.gz"))
        (folder / wheel.name).write_bytes(wheel.read_bytes())
        (folder / sdist.name).write_bytes(plain(sdist.read_bytes(), when))
        return [folder / wheel.name, folder / sdist.name]


def _copy_sources(to: Path, released: str, when: int) -> None:
    """Copy what a build needs: it would leave files in the repository, and find old ones."""
    for name in _SOURCES:
        source, place = ROOT / name, to / name
        place.parent.mkdir(exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, place, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copyfile(source, place)
    init = to / "gateway/__init__.py"
    init.write_text(_VERSION.sub(f'__version__ = "{released}"', init.read_text()))
    for path in to.rglob("*"):
        path.chmod(0o755 if path.is_dir() else 0o644)
        os.utime(path, (when, when))


def run(command: list[str], environment: dict[str, str] | None = None, data: bytes | None = None) -> bytes:
    """Run a program and return its standard output. Raises SystemExit with its error output."""
    done = subprocess.run(command, cwd=ROOT, env=environment, input=data, umask=0o022, capture_output=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command)}:\n{done.stdout.decode()}{done.stderr.decode()}")
    return done.stdout


def _git(*arguments: str) -> str:
    """Return what git prints; "" without git, or without a repository."""
    try:
        return subprocess.run([*_GIT, *arguments], capture_output=True, text=True, check=False).stdout.strip()
    except FileNotFoundError:
        return ""


def plain(sdist: bytes, when: int) -> bytes:
    """Return a tar.gz with the same files, without owners, times and order of a machine."""
    written = io.BytesIO()
    with (
        tarfile.open(fileobj=io.BytesIO(sdist)) as found,
        gzip.GzipFile(filename="", fileobj=written, mode="wb", mtime=when) as packed,
        tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as archive,
    ):
        for each in sorted((each for each in found if each.isfile()), key=lambda each: each.name):
            entry = tarfile.TarInfo(each.name)
            entry.size, entry.mtime, entry.mode = each.size, when, 0o755 if each.mode & 0o100 else 0o644
            archive.addfile(entry, found.extractfile(each))
    return written.getvalue()
