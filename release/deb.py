"""hexapod-gateway_VERSION_ARCHITECTURE.deb: all that a robot needs but Python itself, for Debian 12 and 13.

`python -m release.deb [--architecture arm64] [--to DIR]`; `make deb` runs it. Nothing is compiled: each dependency
comes as a wheel with the lock's hash; spidev has none, and the gateway makes its calls itself. Compiled parts have
their Python in their names, so one folder holds those of all Pythons. Each machine makes the same bytes of a commit.
"""

import argparse
import hashlib
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final
from zipfile import ZipFile

from release.build import ROOT, UV, build, epoch, run, version
from release.documents import EXTRAS

PYTHONS: Final = ("3.11", "3.13")
"""The Pythons of Debian 12 and 13, and of the Raspberry Pi OS made of them."""
PROCESSORS: Final = {"amd64": "x86_64", "arm64": "aarch64"}
LIBC: Final = "manylinux_2_34"
"""Debian 12 has 2.36; this is the newest before it for which wheels are built."""
DEPLOY: Final = ROOT / "deploy"
CONFFILE: Final = "etc/needrestart/conf.d/hexapod-gateway.conf"
"""dpkg keeps what a person has changed in it."""
SCRIPTS: Final = ("preinst", "postinst", "prerm", "postrm")
_OF_AN_INSTALLATION: Final = {"RECORD", "INSTALLER", "REQUESTED", "WHEEL", "direct_url.json", "sboms"}
"""Files that an installer of wheels writes, or that differ for each Python."""


def debian_version(released: str, when: int) -> str:
    """Return the release as dpkg sorts it: 1.2.0rc1 before 1.2.0, and an earlier commit before a later one."""
    number, plus, commit = released.partition("+")
    number = re.sub(r"(a|b|rc)(?=\d)", r"~\1", number).replace(".dev", "~~dev")
    return f"{number}+{time.strftime('%Y%m%d%H%M%S', time.gmtime(when))}.{commit}" if plus else number


def dependencies(folder: Path, architecture: str) -> Path:
    """Install all wheels of the lock for each Python, together in one folder. Return the folder."""
    requirements = folder / "requirements.txt"
    export = [UV, "export", "--quiet", "--frozen", "--no-config", "--no-header", "--no-annotate"]
    export += ["--format", "requirements.txt", "--no-emit-project", "--no-emit-package", "spidev", *EXTRAS]
    requirements.write_bytes(run(export))
    install = [UV, "pip", "install", "--quiet", "--no-config", "--require-hashes", "--no-deps"]
    install += [
        "--only-binary",
        ":all:",
        "--link-mode",
        "copy",
        "--python-platform",
        f"{PROCESSORS[architecture]}-{LIBC}",
    ]
    together = folder / "together"
    for python in PYTHONS:
        of_one = folder / python
        run([*install, "--python-version", python, "--target", str(of_one), "-r", str(requirements)])
        for path in sorted(of_one.rglob("*")):
            name = path.relative_to(of_one)
            if path.is_file() and name.parts[0] != "bin" and not _is_left_out(name):
                _add(path.read_bytes(), together / name)
    return together


def deb(to: Path, wheel: Path, packages: Path, released: str, when: int, architecture: str, pack: str = "xz") -> Path:
    """Make the package of our `wheel` with these dependencies. Return its path. `pack`: dpkg-deb's compression.

    At level 3 xz takes 20 s and makes 32 MB (30 for arm64).
    """
    full = debian_version(released, when)
    path = to / f"hexapod-gateway_{full}_{architecture}.deb"
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary) / "root"
        _fill(root, full, wheel, packages)
        files = [each for each in root.rglob("*") if each.is_file() and not each.is_symlink()]
        size = sum(-(-each.stat().st_size // 1024) for each in files)
        given = {"VERSION": full, "ARCHITECTURE": architecture, "SIZE": str(size)}
        control = root / "DEBIAN"
        control.mkdir()
        for name in ("control", "triggers", *SCRIPTS):
            _write(DEPLOY / "debian" / name, control / name, given)
        sums = (f"{_md5(each)}  {each.relative_to(root)}\n" for each in sorted(files) if each != root / CONFFILE)
        (control / "md5sums").write_text("".join(sums))
        (control / "conffiles").write_text(f"/{CONFFILE}\n")
        for each in (root, *root.rglob("*")):
            if not each.is_symlink():
                each.chmod(0o755 if each.is_dir() or each.name in {"hexapod-gateway", *SCRIPTS} else 0o644)
            os.utime(each, (when, when), follow_symlinks=False)
        environment = {**os.environ, "SOURCE_DATE_EPOCH": str(when)}
        options = ["--root-owner-group", "--threads-max=1", f"-Z{pack}", "-z3"]
        run(["dpkg-deb", *options, "--build", str(root), str(path)], environment)
    return path


def deb_with_dependencies(to: Path, wheel: Path, released: str, when: int, architecture: str) -> Path:
    """Make the package of our `wheel` with the lock's dependencies. Return its path."""
    with tempfile.TemporaryDirectory() as temporary:
        return deb(to, wheel, dependencies(Path(temporary), architecture), released, when, architecture)


def _fill(root: Path, full: str, wheel: Path, packages: Path) -> None:
    """Write the robot's files below `root`."""
    payload = root / "usr/lib/hexapod-gateway" / full
    shutil.copytree(packages, payload)
    with ZipFile(wheel) as packed:
        for name in packed.namelist():
            if not _is_left_out(Path(name)):
                _add(packed.read(name), payload / name)
    units = ("hexapod-gateway.service", "hexapod-thaw.service", "hexapod-console.service", "hexapod-console.socket")
    for unit in units:
        _write(DEPLOY / "systemd" / unit, payload / "units" / unit, {})
    share = root / "usr/share/hexapod-gateway"
    for name, place in {
        "debian/command": root / "usr/bin/hexapod-gateway",
        "debian/hexapod-gateway": payload / "hexapod-gateway",
        "debian/__main__.py": payload / "__main__.py",
        "debian/sysusers.conf": root / "usr/lib/sysusers.d/hexapod-gateway.conf",
        "debian/needrestart.conf": root / CONFFILE,
        "udev/60-hexapod-gateway.rules": root / "usr/lib/udev/rules.d/60-hexapod-gateway.rules",
        "gateway.toml": share / "gateway.toml",
        "systemd/console.conf": share / "console.conf",
        "systemd/simulated.conf": share / "simulated.conf",
    }.items():
        _write(DEPLOY / name, place, {})


def _write(source: Path, place: Path, given: Mapping[str, str]) -> None:
    """Copy a file of deploy/ with its @NAMES@ replaced."""
    text = source.read_text().replace("@KEEP@\n", (DEPLOY / "debian/keep.sh").read_text())
    for name, value in {**given, "PYTHONS": " ".join(f"/usr/bin/python{each}" for each in PYTHONS)}.items():
        text = text.replace(f"@{name}@", value)
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(text)


def _md5(path: Path) -> str:
    """Return the MD5 sum: `dpkg --verify` knows no other."""
    return hashlib.md5(path.read_bytes(), usedforsecurity=False).hexdigest()


def _add(content: bytes, place: Path) -> None:
    if place.exists() and place.read_bytes() != content:
        raise SystemExit(f"{place.name} differs between the wheels of {' and '.join(PYTHONS)}")
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_bytes(content)


def _is_left_out(name: Path) -> bool:
    return (len(name.parts) == 1 and name.name == ".lock") or (
        name.parts[0].endswith(".dist-info") and name.parts[1] in _OF_AN_INSTALLATION
    )


def main(arguments: Sequence[str]) -> int:
    """Build our wheel and the package."""
    parser = argparse.ArgumentParser(prog="python -m release.deb", description=__doc__)
    parser.add_argument("--to", type=Path, default=ROOT / "dist")
    own = run(["dpkg", "--print-architecture"]).decode().strip()
    parser.add_argument("--architecture", choices=PROCESSORS, default=own, help="default: this machine's, %(default)s")
    options = parser.parse_args(arguments)
    options.to.mkdir(parents=True, exist_ok=True)
    released, when = version(), epoch()
    with tempfile.TemporaryDirectory() as temporary:
        wheel, _ = build(Path(temporary), released, when)
        path = deb_with_dependencies(options.to, wheel, released, when, options.architecture)
    sys.stdout.write(f"{path}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
