"""QEMU, Debian's kernel and its headers, downloaded and unpacked without installing them; the module, built."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
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
    qemu: tuple[str, ...]
    """QEMU, and its options that depend on the architecture."""
    console: str
    begin: str
    """What the first program does once the files are mounted: lines for busybox's shell, with {scenes}."""
    system: Path = Path("/")
    """The machine's files. It writes none of them."""
    cache: Path = CACHE
    longest_s: int = 900

    @property
    def kernel(self) -> Path:
        return self.root / "boot" / f"vmlinuz-{self.release}"

    @property
    def drivers(self) -> Path:
        return self.root / "lib" / "modules" / self.release / "kernel"


_BEGIN: Final = f"""export PATH=/usr/bin:/bin:/usr/sbin:/sbin PYTHONDONTWRITEBYTECODE=1 HOME=/tmp TMPDIR=/tmp
/bin/busybox chroot /root /bin/sh -c 'cd {ROOT} && exec {sys.executable} -m tests.kernel.inside {{scenes}}' \\
    >/root/run/kernel-test/output 2>&1
/bin/busybox sync
/bin/busybox poweroff -f
"""


def prepare(cache: Path = CACHE) -> Parts:
    """Everything that a boot needs; downloads once. Raises PartsError."""
    need("apt-get", "dpkg-deb", "make", "gcc-12", "setpriv")
    root = unpacked(cache, _download)
    qemu = (
        str(root / "usr/bin/qemu-system-x86_64"),
        *("-L", str(root / "usr/share/seabios"), "-L", str(root / "usr/share/qemu")),
        *("-accel", _accelerator(), "-cpu", "max", "-m", "2048"),
    )
    return Parts(root, *built(root, cache / "module"), qemu, "ttyS0", _BEGIN)


def need(*tools: str) -> None:
    for tool in tools:
        if shutil.which(tool) is None:
            raise PartsError(f"{tool} is missing; make kernel needs Debian 12 with make and gcc-12")


def unpacked(cache: Path, download: Callable[[Path], list[Path]]) -> Path:
    """The folder of all packages' files, made once for these packages."""
    root, noted, wanted = cache / "root", cache / "unpacked", " ".join(_WANTED)
    if not noted.exists() or noted.read_text() != wanted:
        shutil.rmtree(root, ignore_errors=True)
        root.mkdir(parents=True)
        for package in download(cache / "debs"):
            run("dpkg-deb", "--extract", str(package), str(root))
        noted.write_text(wanted)
    return root


def _accelerator() -> str:
    """KVM only where the processor says that it can: within another virtual machine /dev/kvm opens, and hangs."""
    flags = Path("/proc/cpuinfo").read_text().split()
    usable = os.access("/dev/kvm", os.R_OK | os.W_OK) and not {"vmx", "svm"}.isdisjoint(flags)
    return "kvm" if usable else "tcg,thread=multi"


def _download(folder: Path) -> list[Path]:
    """The packages that this machine lacks, and our own, by apt's own knowledge and with its signatures."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    plan = ("--simulate", "--no-install-recommends", "install", *_WANTED)
    lacking = re.findall(r"^Inst (\S+)", run("apt-get", *plan), re.MULTILINE)
    ours = _OUR_OWN.findall(run("apt-get", "--option", "Dir::State::status=/dev/null", *plan))  # as if bare
    names = [name for name in (*lacking, *ours) if not _LEFT_OUT.search(name)]
    run("apt-get", "--quiet", "download", *sorted({*names, kernel("amd64")}), cwd=folder)
    return sorted(folder.glob("*.deb"))


def kernel(architecture: str, *options: str) -> str:
    """The name of the package of Debian's present kernel. `options`: of apt."""
    image = re.search(
        r"Depends: (linux-image-\S+)", run("apt-cache", *options, "depends", f"linux-image-{architecture}")
    )
    if image is None:
        raise PartsError(f"apt knows no linux-image-{architecture}; apt-get update?")
    return image[1]


def _release(root: Path) -> str:
    found = sorted((root / "boot").glob("vmlinuz-*"))
    if len(found) != 1:
        raise PartsError(f"{root / 'boot'} has {len(found)} kernels, and should have one; remove {root.parent}")
    return found[0].name.removeprefix("vmlinuz-")


def built(root: Path, folder: Path, *options: str) -> tuple[str, Path]:
    """Return the kernel's release and the module for it, built anew if its source has changed."""
    release = _release(root)
    sources = sorted(MODULE.iterdir())
    module = folder / "spirec.ko"
    wanted = release + "".join(source.read_text() for source in sources)
    noted = folder / "source"
    if module.exists() and noted.exists() and noted.read_text() == wanted:
        return release, module
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(MODULE, folder)
    headers = root / "usr" / "src" / f"linux-headers-{release}"
    common = headers.with_name(re.sub(r"-(amd64|arm64)$", "-common", release).join(("linux-headers-", "")))
    (headers / "Makefile").write_text(f"include {common}/Makefile\n")  # Debian's names /usr/src
    run("make", "-C", str(headers), f"M={folder}", *options)
    noted.write_text(wanted)
    return release, module


def run(*command: str, cwd: Path | None = None) -> str:
    ended = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    if ended.returncode:
        last = (ended.stderr.strip() or ended.stdout.strip()).splitlines()[-1:]
        raise PartsError(f"{' '.join(command[:3])} … failed: {''.join(last)}")
    return ended.stdout
