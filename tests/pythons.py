"""`python -m tests.pythons`: `make test` with each Debian's Python, as an ordinary user in a fresh clone. Needs root.

A chroot holds what the Debian has. The user's shell has a login shell's environment, umask 077, and once a locale that
is not installed. Prints for each its Python, what pytest counted, and seconds. Exit code 1: a run was not green.
"""

import argparse
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Final

from tests.support.runs import ENDS_WITH_US

ROOT: Final = Path(__file__).parents[1]
CACHE: Final = ROOT / "build" / "pythons"
SUITES: Final = {"bookworm": "", "trixie": "", "forky": "de_DE.UTF-8"}
"""Debian 12 (Python 3.11), 13 (3.13) and its testing (3.14), each with its LANG."""
BETWEEN: Final = "3.12"
"""No Debian of today has this one: pyenv's, on Debian 12."""
_PACKAGES: Final = "python3-venv,python3-dev,gcc,git,make,ca-certificates,procps,iproute2,openssh-client"
_SCRIPTS: Final = Path("/usr/share/debootstrap/scripts")
_PIP: Final = ("etc/pip.conf", "etc/hosts", "etc/resolv.conf", "etc/ssl/certs/ca-certificates.crt")
"""This machine's way to the packages."""
_RUN: Final = """
mount -t proc proc "$1/proc"; mount --rbind /dev "$1/dev"; mount -t tmpfs -o mode=1777 tmpfs "$1/tmp"
python=python3; [ -z "$3" ] || { mount --bind "$3" "$1/opt"; chroot "$1" ldconfig /opt/lib; python=/opt/bin/python3; }
exec chroot "$1" su - person -c "umask 077; ${2:+export LANG=$2;} rm -rf tree &&
    git clone -q /src.bundle tree && cd tree && $python --version && make test PYTHON=$python"
"""
_TOLD: Final = re.compile(r"^Python \S+|^=+ (?=.* (?:passed|failed))(.*?) in ")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.pythons", description="make test with each Debian's Python.")
    names = (*SUITES, BETWEEN)
    parser.add_argument("names", nargs="*", choices=[*names, []], metavar="name", help=", ".join(names))
    chosen: list[str] = parser.parse_args().names or list(names)
    rows = [_tried(name) for name in chosen]
    print(*rows, sep="\n")
    return 1 if any(row.startswith("✗") for row in rows) else 0


def _tried(name: str) -> str:
    between = sorted(Path.home().glob(f".pyenv/versions/{BETWEEN}.*"))[-1:] if name == BETWEEN else []
    if name == BETWEEN and not between:
        return f"– {name}: pyenv has none here"
    root = _made("bookworm" if between else name)
    head = ["git", "-C", str(ROOT), "-c", "safe.directory=*"]
    subprocess.run([*head, "bundle", "create", "--quiet", str(root / "src.bundle"), "HEAD"], check=True)
    command = [*ENDS_WITH_US, "bash", "-ec", _RUN, "sh", str(root)]
    begun_s = time.monotonic()
    code, told = _run([*command, SUITES.get(name, ""), str(between[0]) if between else ""])
    return f"{'✗' if code else '✓'} {name}: {', '.join(told)}; with its installation {time.monotonic() - begun_s:.0f} s"


def _run(command: list[str]) -> tuple[int, list[str]]:
    """Run it. Return its exit code, and the Python and the counts that it prints."""
    told: list[str] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, errors="replace") as run:
        assert run.stdout is not None
        for line in run.stdout:
            print(line, end="", flush=True)
            told += [(found[1] or found[0]).strip() for found in _TOLD.finditer(line)]
    return run.returncode, told


def _made(suite: str) -> Path:
    """Return a chroot with a user, made once by debootstrap."""
    root = CACHE / suite
    if not (root / "home" / "person").exists():
        shutil.rmtree(root, ignore_errors=True)
        root.mkdir(parents=True)
        script = _SCRIPTS / suite if (_SCRIPTS / suite).exists() else _SCRIPTS / "sid"
        command = [*ENDS_WITH_US, "debootstrap", "--variant=minbase", f"--include={_PACKAGES}", suite, str(root)]
        subprocess.run([*command, "http://deb.debian.org/debian", str(script)], check=True, stdout=subprocess.DEVNULL)
        for name in _PIP:
            if Path("/", name).exists():
                shutil.copy(f"/{name}", root / name)
        subprocess.run(["chroot", str(root), "useradd", "--create-home", "person"], check=True)
    return root


if __name__ == "__main__":
    sys.exit(main())
