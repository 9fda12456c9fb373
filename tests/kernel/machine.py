"""The virtual machine: one boot, watched until it powers off. It ends with this process, however that ends."""

import os
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from tests.kernel import initramfs
from tests.kernel.parts import CACHE, LIBRARIES, Parts, PartsError

LONGEST_S: Final = 900


def boot(parts: Parts, scenes: str, options: str, look: Callable[[Path], None], cache: Path = CACHE) -> None:
    """Boot with these kernel options, run the scenes, and wait for the end; `look` sees their folder now and then.

    Raises PartsError where it does not end in time.
    """
    out = cache / "out"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    initrd = initramfs.build(parts, scenes, cache / "initramfs.gz")
    libraries = ":".join(str(parts.root / name) for name in LIBRARIES)
    command = [
        *("setpriv", "--pdeathsig", "KILL"),  # the kernel kills it when this process ends, also by SIGKILL
        str(parts.root / "usr/bin/qemu-system-x86_64"),
        *("-L", str(parts.root / "usr/share/seabios"), "-L", str(parts.root / "usr/share/qemu")),
        *("-accel", _accelerator(), "-cpu", "max", "-smp", "2", "-m", "2048"),
        *("-nodefaults", "-display", "none", "-no-reboot", "-serial", f"file:{cache / 'console.log'}"),
        *("-kernel", str(parts.kernel), "-initrd", str(initrd)),
        *("-append", f"console=ttyS0 quiet panic=-1 {options}".rstrip()),
        *("-virtfs", "local,path=/,mount_tag=root,security_model=none,readonly=on,multidevs=remap"),
        *("-virtfs", f"local,path={out},mount_tag=out,security_model=none"),
    ]
    with (cache / "qemu.log").open("w") as log:
        machine = subprocess.Popen(
            command,
            env={**os.environ, "LD_LIBRARY_PATH": libraries},
            stdin=subprocess.DEVNULL,
            stderr=log,
            start_new_session=True,  # Ctrl-C is for us: QEMU would power off, as if all scenes had been played
        )
    deadline_s = time.monotonic() + LONGEST_S
    try:
        while machine.poll() is None:
            if time.monotonic() > deadline_s:
                raise PartsError(f"the virtual machine still runs after {LONGEST_S} s; see {cache}/console.log")
            look(out)
            time.sleep(0.5)
        look(out)
    finally:
        machine.kill()
        machine.wait()
    if machine.returncode:
        raise PartsError(f"QEMU ended with {machine.returncode}; see {cache}/qemu.log")


def _accelerator() -> str:
    """KVM only where the processor says that it can: within another virtual machine /dev/kvm opens, and hangs."""
    flags = Path("/proc/cpuinfo").read_text().split()
    usable = os.access("/dev/kvm", os.R_OK | os.W_OK) and not {"vmx", "svm"}.isdisjoint(flags)
    return "kvm" if usable else "tcg,thread=multi"
