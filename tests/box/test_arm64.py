"""The arm64 package, as a Pi runs it: with Debian's Pythons of arm64 under QEMU, a simulated robot takes a command."""

import os
import shutil
import subprocess
from pathlib import Path
from typing import Final

import pytest

from release.build import build
from release.deb import deb, dependencies
from tests.box.box import PATH_INSIDE, lacks_tools
from tests.box.installed import WHEN
from tests.support.child import Child
from tests.support.schedule import skip_where

pytestmark = [pytest.mark.nightly, pytest.mark.alone]

QEMU: Final = "/usr/bin/qemu-aarch64-static"
MACHINE: Final = (
    'ip link set lo up && mount -t proc proc "$1/proc" && mount --bind /dev "$1/dev" && echo ready && read -r _'
)
IMPORTS: Final = """
import importlib, pathlib, platform, sys
folder, tag = pathlib.Path(sys.argv[1]), f"cpython-{sys.version_info[0]}{sys.version_info[1]}-aarch64-linux-gnu"
sys.path.insert(0, str(folder))
of_this = [each for each in folder.rglob("*.so") if f".{tag}." in each.name or ".abi3." in each.name]
for each in of_this:
    importlib.import_module(".".join(each.relative_to(folder).parts).partition(".so")[0].replace(f".{tag}", "")
        .removesuffix(".abi3"))
print(platform.machine(), len(of_this))
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    skip_where(lacks_tools("the arm64 package is", QEMU, "debootstrap", "unshare", "nsenter"))
    folder = tmp_path_factory.mktemp("arm64")
    wheel, _ = build(folder, "1.1.0", WHEN)
    return deb(folder, wheel, dependencies(folder, "arm64"), "1.1.0", WHEN, "arm64", pack="none")


@pytest.mark.parametrize(("suite", "python"), [("bookworm", "3.11"), ("trixie", "3.13")])
def test_a_simulated_robot_takes_a_command(suite: str, python: str, package: Path, tmp_path: Path) -> None:
    root = tmp_path / suite
    command = ["debootstrap", "--arch=arm64", "--download-only", "--variant=minbase", "--include=python3", suite]
    subprocess.run([*command, str(root)], check=True, capture_output=True, timeout=1200)
    for each in (*sorted((root / "var/cache/apt/archives").glob("*.deb")), package):
        with subprocess.Popen(["dpkg-deb", "--fsys-tarfile", str(each)], stdout=subprocess.PIPE) as unpacked:
            into = ["tar", "--extract", "--keep-directory-symlink", "--directory", str(root)]
            subprocess.run(into, stdin=unpacked.stdout, check=True)
    shutil.copy(QEMU, root)
    run = (f"/{Path(QEMU).name}", f"/usr/bin/python{python}", "-IS")
    own = "/usr/lib/hexapod-gateway/1.1.0"
    with Child(["unshare", "--mount", "--net", "sh", "-c", MACHINE, "sh", str(root)], os.environ) as machine:
        machine.wait_for_output("ready")
        inside = ["nsenter", f"--target={machine.pid}", "--mount", "--net", "chroot", str(root), *run]
        env = {"PATH": PATH_INSIDE, "LANG": "C.UTF-8"}
        imported = subprocess.run([*inside, "-c", IMPORTS, own], env=env, capture_output=True, text=True, check=True)
        assert imported.stdout.startswith("aarch64 "), imported
        assert int(imported.stdout.split()[1]) > 10
        if suite == "trixie":
            return  # its Python has stood still under QEMU, once of two times
        with Child([*inside, own, "run", "--sim"], env) as gateway:
            gateway.wait_for_output("is ready", timeout_s=240)
            sent = [*inside, own, "send", "leg", "3", "start", "90", "45", "120", "--timeout", "60"]
            done = subprocess.run(sent, env=env, capture_output=True, text=True, check=False, timeout=240)
            assert done.stdout == "accepted\n", done
            gateway.terminate()
            assert gateway.wait(60) == 0
