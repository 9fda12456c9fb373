"""A spidev wheel for a robot's Python, compiled on another machine: PyPI has that package as source only.

`python -m release.spidev FOLDER SDIST VERSION` puts spidev-…-linux_aarch64.whl into FOLDER. It needs Debian's cross
compiler (gcc-aarch64-linux-gnu, libc6-dev-arm64-cross) and takes the headers of that Python from Debian's archive, by
an apt with folders of its own. Status 3: this machine cannot, as it says. The same compiler makes the same bytes,
wherever and whenever it runs.
"""

import base64
import hashlib
import io
import os
import shutil
import sys
import tarfile
import tempfile
import time
import zipfile
from collections.abc import Sequence
from pathlib import Path

from release.build import run

COMPILER = "aarch64-linux-gnu-gcc"
C_LIBRARY = Path("/usr/aarch64-linux-gnu/include/stdio.h")
SUITES = {"3.11": "bookworm", "3.13": "trixie"}
"""Where Debian has the headers of which Python. Raspberry Pi OS 12 and 13 are made of these."""
KEYRING = Path("/usr/share/keyrings/debian-archive-keyring.gpg")
ARCHIVE = "http://deb.debian.org/debian"
FLAGS = ("-shared", "-fPIC", "-O2", "-g0", "-fno-ident", "-Wl,--build-id=none", "-Wl,-s")
CANNOT = 3


class CannotBuildError(Exception):
    """What this machine lacks, in one sentence."""


def lacks() -> str:
    """What is missing to compile for a robot, in one line; empty when nothing."""
    if shutil.which(COMPILER) is None or not C_LIBRARY.exists():
        return "there is no cross compiler: apt-get install gcc-aarch64-linux-gnu libc6-dev-arm64-cross"
    return ""


def headers(version: str, folder: Path) -> list[Path]:
    """The folders with the headers of an aarch64 Python, fetched into `folder`. Raises CannotBuildError."""
    suite = SUITES.get(version)
    if suite is None:
        raise CannotBuildError(f"for Python {version} no headers are known")
    if shutil.which("apt-get") is None or not KEYRING.exists():
        raise CannotBuildError(f"the headers of Python {version} come by Debian's apt, which is not here")
    for name in ("state/lists/partial", "cache/archives/partial"):
        (folder / name).mkdir(parents=True)
    (folder / "sources.list").write_text(f"deb [arch=arm64 signed-by={KEYRING}] {ARCHIVE} {suite} main\n")
    (folder / "status").touch()
    (folder / "apt.conf").write_text(
        f'Dir "{folder}"; Dir::State "state"; Dir::State::status "status"; Dir::Cache "cache"; Dir::Etc "";\n'
        f'Dir::Etc::sourcelist "sources.list"; Dir::Etc::sourceparts "-"; Dir::Etc::preferencesparts "-";\n'
        f'APT::Architecture "arm64"; APT::Architectures "arm64"; APT::Sandbox::User "";\n'
        'Acquire::Languages "none"; Acquire::Retries "3";\n'
    )
    apt = ["env", f"--chdir={folder}", f"APT_CONFIG={folder / 'apt.conf'}", "apt-get", "--quiet"]
    try:
        run([*apt, "update"])
        run([*apt, "download", f"libpython{version}-dev"])
        run(["dpkg-deb", "--extract", str(next(folder.glob("*.deb"))), str(folder / "root")])
    except SystemExit as error:
        raise CannotBuildError(f"Debian's archive did not give the headers of Python {version}: {error}") from error
    include = folder / "root" / "usr" / "include"
    return [include / f"python{version}", include]


def wheel(sdist: Path, version: str, includes: Sequence[Path], compiler: str, when: int) -> tuple[str, bytes]:
    """Its name and its bytes, for that Python on aarch64."""
    package = sdist.name.removesuffix(".tar.gz")
    with tarfile.open(sdist) as archive:
        source, about = (_member(archive, f"{package}/{name}") for name in ("spidev_module.c", "PKG-INFO"))
    python = f"cp{version.replace('.', '')}"
    tag = f"{python}-{python}-linux_aarch64"
    files = {
        f"spidev.{python.replace('cp', 'cpython-')}-aarch64-linux-gnu.so": compiled(source, includes, compiler),
        f"{package}.dist-info/METADATA": about,
        f"{package}.dist-info/WHEEL": f"Wheel-Version: 1.0\nRoot-Is-Purelib: false\nTag: {tag}\n".encode(),
    }
    record = f"{package}.dist-info/RECORD"
    lines = [f"{name},sha256={_digest(data)},{len(data)}\n" for name, data in files.items()]
    files[record] = "".join([*lines, f"{record},,\n"]).encode()
    written = io.BytesIO()
    with zipfile.ZipFile(written, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, data in files.items():
            entry = zipfile.ZipInfo(name, time.gmtime(when)[:6])
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if name.endswith(".so") else 0o644) << 16
            packed.writestr(entry, data)
    return f"{package}-{tag}.whl", written.getvalue()


def compiled(source: bytes, includes: Sequence[Path], compiler: str) -> bytes:
    """The module as a shared object without a trace of the folders, the time and the machine."""
    with tempfile.TemporaryDirectory() as temporary:
        (Path(temporary) / "spidev_module.c").write_bytes(source)
        folders = [part for path in includes for part in (f"-I{path}", f"-ffile-prefix-map={path}=.")]
        options = [*FLAGS, f"-ffile-prefix-map={temporary}=.", *folders]
        in_folder = ["env", f"--chdir={temporary}", "LC_ALL=C", compiler]
        run([*in_folder, *options, "-o", "spidev.so", "spidev_module.c"])
        return (Path(temporary) / "spidev.so").read_bytes()


def _member(archive: tarfile.TarFile, name: str) -> bytes:
    content = archive.extractfile(name)
    if content is None:
        raise SystemExit(f"{name} in spidev's sources is no file")
    return content.read()


def _digest(data: bytes) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()


def main(folder: str, sdist: str, version: str) -> int:
    """Fetch, compile, write; its exit status."""
    try:
        if lack := lacks():
            raise CannotBuildError(lack)
        with tempfile.TemporaryDirectory() as temporary:
            includes = headers(version, Path(temporary))
            name, data = wheel(Path(sdist), version, includes, COMPILER, int(os.environ["SOURCE_DATE_EPOCH"]))
    except CannotBuildError as error:
        sys.stderr.write(f"no wheel of spidev for aarch64: {error}\n")
        return CANNOT
    (Path(folder) / name).write_bytes(data)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
