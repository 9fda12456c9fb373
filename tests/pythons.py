"""`python -m tests.pythons`: `make test` with each Debian's Python, as an ordinary user in a fresh clone. Needs root.

A chroot holds what the Debian has. The user's shell has a login shell's environment, umask 077, and once a locale that
is not installed. Exit code 1: a run was not green.
"""

import argparse
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]
CACHE: Final = ROOT / "build" / "pythons"
SUITES: Final = {"bookworm": "", "trixie": "", "forky": "de_DE.UTF-8"}
"""Debian 12 (Python 3.11), 13 (3.13) and its testing (3.14), each with its LANG."""
_PACKAGES: Final = "python3-venv,python3-dev,gcc,git,make,ca-certificates,procps,iproute2,openssh-client"
_SCRIPTS: Final = Path("/usr/share/debootstrap/scripts")
_PIP: Final = ("etc/pip.conf", "etc/hosts", "etc/resolv.conf", "etc/ssl/certs/ca-certificates.crt")
"""This machine's way to the packages."""
_RUN: Final = """
mount -t proc proc "$1/proc"; mount --rbind /dev "$1/dev"; mount -t tmpfs -o mode=1777 tmpfs "$1/tmp"
exec chroot "$1" su - person -c "umask 077; ${2:+export LANG=$2;} rm -rf tree &&
    git clone -q /src.bundle tree && cd tree && python3 --version && make test"
"""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.pythons", description="make test with each Debian's Python.")
    parser.add_argument("suites", nargs="*", choices=[*SUITES, []], metavar="suite", help=", ".join(SUITES))
    chosen: list[str] = parser.parse_args().suites or list(SUITES)
    rows = [_tried(suite) for suite in chosen]
    print(*rows, sep="\n")
    return 0 if all(row.startswith("✓") for row in rows) else 1


def _tried(suite: str) -> str:
    root = _made(suite)
    head = ["git", "-C", str(ROOT), "-c", "safe.directory=*"]
    subprocess.run([*head, "bundle", "create", "--quiet", str(root / "src.bundle"), "HEAD"], check=True)
    begun_s = time.monotonic()
    command = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "bash", "-ec", _RUN, "sh", str(root)]
    ended = subprocess.run([*command, SUITES[suite]], check=False)
    return f"{'✗' if ended.returncode else '✓'} {suite}: {time.monotonic() - begun_s:.0f} s"


def _made(suite: str) -> Path:
    """Return a chroot with a user; debootstrap makes it once."""
    root = CACHE / suite
    if not (root / "home" / "person").exists():
        shutil.rmtree(root, ignore_errors=True)
        root.mkdir(parents=True)
        script = _SCRIPTS / suite if (_SCRIPTS / suite).exists() else _SCRIPTS / "sid"
        command = ["debootstrap", "--variant=minbase", f"--include={_PACKAGES}", suite, str(root)]
        subprocess.run([*command, "http://deb.debian.org/debian", str(script)], check=True, stdout=subprocess.DEVNULL)
        for name in _PIP:
            if Path("/", name).exists():
                shutil.copy(f"/{name}", root / name)
        subprocess.run(["chroot", str(root), "useradd", "--create-home", "person"], check=True)
    return root


if __name__ == "__main__":
    sys.exit(main())
