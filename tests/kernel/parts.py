"""QEMU, Debian's kernel and its headers, downloaded and unpacked without installing them; the module, built."""

import re
import shutil
import subprocess
from pathlib import Path
from typing import Final, NamedTuple

HERE: Final = Path(__file__).parent
ROOT: Final = HERE.parents[1]
CACHE: Final = ROOT / "build" / "kernel"
MODULE: Final = HERE / "module"
LIBRARIES: Final = ("usr/lib/x86_64-linux-gnu", "lib/x86_64-linux-gnu")
_WANTED: Final = ("qemu-system-x86", "seabios", "busybox-static", "linux-headers-amd64", "ustreamer")
_LEFT_OUT: Final = re.compile(r"systemd|udev|linux-(perf|libc-dev|compiler|headers-amd64)|ipxe")
"""What apt would also install or upgrade, and a machine without a network or a console does without."""
_OUR_OWN: Final = re.compile(r"^Inst ((?:qemu|seabios|busybox|linux-(?:headers|kbuild))\S*)", re.MULTILINE)
"""Unpacked even if installed: QEMU loads its modules and firmware from beside its program, and headers belong to one
kernel. Installed libraries are found where they are."""


class PartsError(Exception):
    """Something is missing, in one sentence."""


class Parts(NamedTuple):
    """The places of all parts."""

    root: Path
    """The packages, unpacked."""
    release: str
    """The kernel's release, such as 6.1.0-56-amd64."""
    module: Path

    @property
    def kernel(self) -> Path:
        return self.root / "boot" / f"vmlinuz-{self.release}"

    @property
    def drivers(self) -> Path:
        return self.root / "lib" / "modules" / self.release / "kernel"


def prepare(cache: Path = CACHE) -> Parts:
    """Everything that a boot needs; downloads once. Raises PartsError."""
    for tool in ("apt-get", "dpkg-deb", "make", "gcc-12", "setpriv"):
        if shutil.which(tool) is None:
            raise PartsError(f"{tool} is missing; make kernel needs Debian 12 with make and gcc-12")
    root = cache / "root"
    unpacked = cache / "unpacked"
    if not unpacked.exists() or unpacked.read_text() != " ".join(_WANTED):
        shutil.rmtree(root, ignore_errors=True)
        root.mkdir(parents=True)
        for package in _download(cache / "debs"):
            _run("dpkg-deb", "--extract", str(package), str(root))
        unpacked.write_text(" ".join(_WANTED))
    release = _release(root)
    return Parts(root, release, _build(root, release, cache / "module"))


def _download(folder: Path) -> list[Path]:
    """The packages that this machine lacks, and our own, by apt's own knowledge and with its signatures."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    plan = ("--simulate", "--no-install-recommends", "install", *_WANTED)
    lacking = re.findall(r"^Inst (\S+)", _run("apt-get", *plan), re.MULTILINE)
    ours = _OUR_OWN.findall(_run("apt-get", "--option", "Dir::State::status=/dev/null", *plan))  # as if bare
    names = [name for name in (*lacking, *ours) if not _LEFT_OUT.search(name)]
    image = re.search(r"Depends: (linux-image-\S+)", _run("apt-cache", "depends", "linux-image-amd64"))
    if image is None:
        raise PartsError("apt knows no linux-image-amd64; apt-get update?")
    _run("apt-get", "--quiet", "download", *sorted({*names, image[1]}), cwd=folder)
    return sorted(folder.glob("*.deb"))


def _release(root: Path) -> str:
    found = sorted((root / "boot").glob("vmlinuz-*"))
    if len(found) != 1:
        raise PartsError(f"{root / 'boot'} has {len(found)} kernels, and should have one; remove {root.parent}")
    return found[0].name.removeprefix("vmlinuz-")


def _build(root: Path, release: str, folder: Path) -> Path:
    """The module for this kernel, built anew if its source has changed."""
    sources = sorted(MODULE.iterdir())
    built = folder / "spirec.ko"
    wanted = release + "".join(source.read_text() for source in sources)
    noted = folder / "source"
    if built.exists() and noted.exists() and noted.read_text() == wanted:
        return built
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(MODULE, folder)
    headers = root / "usr" / "src" / f"linux-headers-{release}"
    common = headers.with_name(headers.name.replace("-amd64", "-common"))
    (headers / "Makefile").write_text(f"include {common}/Makefile\n")  # Debian's names /usr/src
    _run("make", "-C", str(headers), f"M={folder}")
    noted.write_text(wanted)
    return built


def _run(*command: str, cwd: Path | None = None) -> str:
    ended = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    if ended.returncode:
        last = (ended.stderr.strip() or ended.stdout.strip()).splitlines()[-1:]
        raise PartsError(f"{' '.join(command[:3])} … failed: {''.join(last)}")
    return ended.stdout
