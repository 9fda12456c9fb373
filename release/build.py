"""Wheel and sdist, equal to the byte wherever and whenever they are built from the same commit.

The build sees a copy of the sources with the commit's time and plain modes (deploy/stamp.sh), and the setuptools of the
lock. It writes the wheel that way by itself (SOURCE_DATE_EPOCH); the sdist's members have owners and times of the
machine, so its archive is written anew.
"""

import gzip
import io
import os
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
UV = str(Path(sys.executable).with_name("uv"))
"""Of the same environment."""
_COPY = '. deploy/stamp.sh && copy_sources "$PWD" "$1" "$2"'


def version() -> str:
    """The release, with the commit unless that has its tag."""
    return _shell('. deploy/stamp.sh && version_of "$PWD"')


def epoch() -> int:
    """When the commit was made, in seconds since 1970, or SOURCE_DATE_EPOCH."""
    return int(os.environ.get("SOURCE_DATE_EPOCH") or _shell('. deploy/stamp.sh && epoch_of "$PWD"'))


def build(folder: Path, released: str, when: int) -> list[Path]:
    """Both, in `folder`."""
    environment = {**os.environ, "SOURCE_DATE_EPOCH": str(when)}
    with tempfile.TemporaryDirectory() as temporary:
        sources, made = Path(temporary) / "sources", Path(temporary) / "made"
        sources.mkdir()
        _shell(_COPY, str(sources), released, environment=environment)
        command = [UV, "build", "--quiet", "--no-config", "--require-hashes", "--build-constraints"]
        lock = ROOT / "deploy" / "lock" / "build.txt"
        run([*command, str(lock), "--out-dir", str(made), str(sources)], environment)
        wheel, sdist = next(made.glob("*.whl")), next(made.glob("*.tar.gz"))
        (folder / wheel.name).write_bytes(wheel.read_bytes())
        (folder / sdist.name).write_bytes(_plain(sdist.read_bytes(), when))
        return [folder / wheel.name, folder / sdist.name]


def plain_tar(members: dict[str, bytes], when: int, modes: dict[str, int] | None = None) -> bytes:
    """A tar of these files, which says nothing of the machine that wrote it."""
    written = io.BytesIO()
    with tarfile.open(fileobj=written, mode="w", format=tarfile.PAX_FORMAT) as archive:
        for name in sorted(members):
            entry = tarfile.TarInfo(name)
            entry.size, entry.mtime, entry.mode = len(members[name]), when, (modes or {}).get(name, 0o644)
            archive.addfile(entry, io.BytesIO(members[name]))
    return written.getvalue()


def run(command: list[str], environment: dict[str, str] | None = None, data: bytes | None = None) -> bytes:
    """Its standard output. Raises SystemExit with what it said."""
    done = subprocess.run(command, cwd=ROOT, env=environment, input=data, umask=0o022, capture_output=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command)}:\n{done.stdout.decode()}{done.stderr.decode()}")
    return done.stdout


def _shell(script: str, *arguments: str, environment: dict[str, str] | None = None) -> str:
    return run(["bash", "-euo", "pipefail", "-c", script, "bash", *arguments], environment).decode().strip()


def _plain(sdist: bytes, when: int) -> bytes:
    """The same files, as a tar.gz without owners, times and order of a machine."""
    members: dict[str, bytes] = {}
    modes: dict[str, int] = {}
    with tarfile.open(fileobj=io.BytesIO(sdist)) as archive:
        for entry in archive:
            content = archive.extractfile(entry)
            if content is not None:
                members[entry.name] = content.read()
                modes[entry.name] = 0o755 if entry.mode & 0o100 else 0o644
    written = io.BytesIO()
    with gzip.GzipFile(filename="", fileobj=written, mode="wb", mtime=when) as packed:
        packed.write(plain_tar(members, when, modes))
    return written.getvalue()
