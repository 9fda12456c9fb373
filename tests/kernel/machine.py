"""The virtual machine: its parts, and one boot, watched until it powers off.

The parts are QEMU, Debian's kernel and its headers, downloaded and unpacked without installing them, and the module,
built. The first files are busybox, the drivers of its root, the module, and what starts the scenes. The machine ends
with this process, however that ends.
"""

import gzip
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
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


# ---- the boot


VIDEOBUF: Final = "drivers/media/common/videobuf2/videobuf2"
DRIVERS: Final = (
    "fs/netfs/netfs", "fs/fscache/fscache", "net/9p/9pnet", "drivers/virtio/virtio_ring", "drivers/virtio/virtio",
    "drivers/virtio/virtio_pci_legacy_dev", "drivers/virtio/virtio_pci_modern_dev", "drivers/virtio/virtio_pci",
    "net/9p/9pnet_virtio", "fs/9p/9p", "fs/overlayfs/overlay",
    "net/can/can", "net/can/can-raw", "drivers/net/can/dev/can-dev", "drivers/net/can/vxcan",
    "drivers/media/rc/rc-core", "drivers/media/cec/core/cec", "drivers/media/mc/mc", "drivers/media/v4l2-core/videodev",
    *(f"{VIDEOBUF}-{each}" for each in ("common", "memops", "v4l2", "vmalloc", "dma-contig")),
    "drivers/media/v4l2-core/v4l2-dv-timings", "drivers/media/common/v4l2-tpg/v4l2-tpg",
    "drivers/media/test-drivers/vivid/vivid",
)  # fmt: skip
"""In the order in which they need each other."""
_INIT: Final = """#!/bin/busybox sh
export PATH=/bin
/bin/busybox --install -s /bin
mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t devtmpfs dev /dev
for each in {drivers} spirec; do
    insmod /$each.ko || echo "KERNEL-TEST: no $each"
done
mount -t 9p -o ro,trans=virtio,version=9p2000.L,cache=loose,msize=512000 root /lower
mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000 out /out
mount -t tmpfs tmpfs /upper; mkdir /upper/files /upper/work
mount -t overlay -o lowerdir=/lower,upperdir=/upper/files,workdir=/upper/work root /root
for each in proc sys dev; do mount --move /$each /root/$each; done
mount -t debugfs debug /root/sys/kernel/debug
for each in tmp run dev/shm; do mkdir -p /root/$each; mount -t tmpfs tmpfs /root/$each; done
mkdir /root/run/kernel-test; mount --move /out /root/run/kernel-test
ifconfig lo 127.0.0.1 up
{begin}"""


def boot(parts: Parts, scenes: str, options: str, look: Callable[[Path], None]) -> None:
    """Boot with these kernel options, run the scenes, and wait for the end; `look` sees their folder now and then.

    Raises PartsError where it does not end in time.
    """
    cache, out = parts.cache, parts.cache / "out"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    initrd = _initramfs(parts, scenes, cache / "initramfs.gz")
    libraries = ":".join(str(parts.root / name) for name in LIBRARIES)
    command = [
        *("setpriv", "--pdeathsig", "KILL"),  # the kernel kills it when this process ends, also by SIGKILL
        *(*parts.qemu, "-smp", "2"),
        *("-nodefaults", "-display", "none", "-no-reboot", "-serial", f"file:{cache / 'console.log'}"),
        *("-kernel", str(parts.kernel), "-initrd", str(initrd)),
        *("-append", f"console={parts.console} quiet panic=-1 {options}".rstrip()),
        *("-virtfs", f"local,path={parts.system},mount_tag=root,security_model=none,readonly=on,multidevs=remap"),
        *("-virtfs", f"local,path={out},mount_tag=out,security_model=none"),
        *("-virtfs", f"local,path={ROOT},mount_tag=tree,security_model=none,readonly=on"),
    ]
    with (cache / "qemu.log").open("w") as log:
        machine = subprocess.Popen(
            command,
            env={**os.environ, "LD_LIBRARY_PATH": libraries},
            stdin=subprocess.DEVNULL,
            stderr=log,
            start_new_session=True,  # Ctrl-C is for us: QEMU would power off, as if all scenes had been played
        )
    deadline_s = time.monotonic() + parts.longest_s
    try:
        while machine.poll() is None:
            if time.monotonic() > deadline_s:
                raise PartsError(f"the virtual machine still runs after {parts.longest_s} s; see {cache}/console.log")
            look(out)
            time.sleep(0.5)
        look(out)
    finally:
        machine.kill()
        machine.wait()
    if machine.returncode:
        raise PartsError(f"QEMU ended with {machine.returncode}; see {cache}/qemu.log")


def _initramfs(parts: Parts, scenes: str, path: Path) -> Path:
    """Write the first files, as the kernel unpacks it: a cpio archive. `scenes`: the arguments of what runs inside."""
    drivers = [each for each in (parts.drivers / f"{name}.ko" for name in DRIVERS) if each.exists()]  # or built in
    begin = parts.begin.format(scenes=scenes)
    init = _INIT.format(drivers=" ".join(each.stem for each in drivers), begin=begin)
    files = {"init": init.encode(), "bin/busybox": (parts.root / "bin/busybox").read_bytes()}
    files |= {each.name: each.read_bytes() for each in (*drivers, parts.module)}
    path.write_bytes(gzip.compress(_cpio(files), 1))
    return path


def _cpio(files: Mapping[str, bytes]) -> bytes:
    folders = ("bin", "dev", "lower", "out", "proc", "root", "sys", "upper")
    entries = [*((name, 0o040755, b"") for name in folders), *((name, 0o100755, data) for name, data in files.items())]
    entries.append(("TRAILER!!!", 0, b""))
    return b"".join(_entry(number, *each) for number, each in enumerate(entries, 1))


def _entry(inode: int, name: str, mode: int, data: bytes) -> bytes:
    """ "new ASCII": thirteen numbers in hex, the name and the data, each filled up to four bytes."""
    fields = (inode, mode, 0, 0, 1, 0, len(data), 0, 0, 0, 0, len(name) + 1, 0)
    head = b"070701" + b"".join(b"%08x" % each for each in fields) + name.encode() + b"\0"
    return head + bytes(-len(head) % 4) + data + bytes(-len(data) % 4)
