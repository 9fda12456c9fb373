"""The parts of a machine for arm64: Debian's kernel, a Debian 12 of its own with systemd, and our package for it.

Its files are made once: QEMU runs Debian's programs for arm64 as programs of this machine, several times as fast as in
the virtual one. That one's processor is emulated, so a scene may take minutes, and only orders are judged.
"""

import shutil
from pathlib import Path
from typing import Final

from tests.box.installed import Packages
from tests.kernel import machine as of
from tests.kernel.machine import Parts, run
from tests.support.runs import ENDS_WITH_US

CACHE: Final = of.CACHE / "arm64"
SYSTEM: Final = CACHE / "system"
RELEASES: Final = ("1.1.0", "1.1.1")
"""The package that is installed, and what it is upgraded to: the same code."""
_MIRROR: Final = "http://deb.debian.org/debian"
_CROSS: Final = "aarch64-linux-gnu-"
_QEMU: Final = (
    *("qemu-system-aarch64", "-M", "virt", "-cpu", "cortex-a72", "-m", "3072"),
    *("-accel", "tcg,thread=single", "-icount", "shift=0"),
)
"""An instruction takes the machine 1 ns, however busy this one is."""
_INCLUDED: Final = "python3,systemd-sysv,dbus,udev,procps,iproute2"
_INSTALL: Final = """
cd /proc/sys/fs/binfmt_misc; [ -e register ] || { mount -t binfmt_misc none .; cd ../binfmt_misc; }
[ -e qemu-aarch64 ] || { trap 'echo -1 >qemu-aarch64' EXIT; cat /usr/lib/binfmt.d/qemu-aarch64.conf >register; }
debootstrap --arch=arm64 --variant=minbase --include=$1 bookworm "$2" $3
"""
"""Linux starts programs for arm64 by QEMU until Debian is installed, in all namespaces: only root can say so."""
_BEGIN: Final = """
units=/root/etc/systemd/system
chmod 755 /root/run; mkdir -p /root/run/tree $units/multi-user.target.wants
ln -s ../kernel-test.service $units/multi-user.target.wants
mount -t 9p -o ro,trans=virtio,version=9p2000.L,cache=loose,msize=512000 tree /root/run/tree
cat >$units/kernel-test.service <<END
[Service]
Environment=HOME=/root PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=/usr/lib/hexapod-gateway/current ZYGOTE=no
WorkingDirectory=/run/tree
StandardOutput=append:/run/kernel-test/output
ExecStartPre=dpkg --install {package}
ExecStart=/usr/bin/python3 -m tests.kernel.inside {{scenes}}
ExecStopPost=sh -c 'journalctl --boot >/run/kernel-test/journal; systemctl poweroff --force --force'
TimeoutStartSec=infinity
TimeoutStopSec=infinity
END
exec /bin/busybox switch_root /root /lib/systemd/systemd
"""


def prepare() -> Parts:
    """Everything that a boot needs. Raises PartsError."""
    of.need("apt-get", "dpkg-deb", "make", "setpriv", "debootstrap", "qemu-aarch64-static", _QEMU[0], f"{_CROSS}gcc-12")
    root = of.unpacked(CACHE, _download)
    made = of.built(root, CACHE / "module", "ARCH=arm64", f"CROSS_COMPILE={_CROSS}")
    if not (SYSTEM / "installed").exists():
        _install()
    shutil.rmtree(CACHE / "packages", ignore_errors=True)
    (CACHE / "packages").mkdir()
    packages = Packages(CACHE / "packages", "arm64")
    first, _ = [Path("/run/tree") / packages.make(release).relative_to(of.ROOT) for release in RELEASES]
    return Parts(root, *made, _QEMU, "ttyAMA0", _BEGIN.format(package=first), SYSTEM, CACHE, 5400)


def _download(folder: Path) -> list[Path]:
    """Debian 12's kernel for arm64 with its headers, and what of them runs on this machine."""
    shutil.rmtree(folder, ignore_errors=True)
    for each in ("lists/partial", "archives/partial"):
        (folder / each).mkdir(parents=True)
    (folder / "list").write_text(
        f"deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] {_MIRROR} bookworm main"
    )
    places = {"State": folder, "Cache": folder, "State::status": "/dev/null", "Etc::sourcelist": folder / "list"}
    options = [
        "APT::Architecture=arm64",
        "APT::Architectures=arm64",
        "APT::Sandbox::User=root",
        "Dir::Etc::sourceparts=-",
    ]
    options += [f"Dir::{name}={place}" for name, place in places.items()]
    apt = [f"--option={each}" for each in options]
    run("apt-get", *apt, "update")
    image = of.kernel("arm64", *apt)
    headers = image.replace("image", "headers")
    names = (image, headers, headers.replace("-arm64", "-common"), "busybox-static")
    run("apt-get", *apt, "download", *names, cwd=folder)
    run("apt-get", "download", "linux-kbuild-6.1", cwd=folder)
    return sorted(folder.glob("*.deb"))


def _install() -> None:
    shutil.rmtree(SYSTEM, ignore_errors=True)
    SYSTEM.mkdir(parents=True)
    run(*ENDS_WITH_US, "sh", "-ec", _INSTALL, "sh", _INCLUDED, str(SYSTEM), _MIRROR)
    run("sh", "-c", "rm -rf proc && mkdir proc", cwd=SYSTEM)  # within a container debootstrap makes it a link
    (SYSTEM / "installed").touch()
