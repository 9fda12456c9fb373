"""The virtual machine: one boot, watched until it powers off. It ends with this process, however that ends.

Its first files are busybox, the drivers of its root, the module, and what starts the scenes.
"""

import gzip
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from tests.kernel.parts import LIBRARIES, ROOT, Parts, PartsError

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
