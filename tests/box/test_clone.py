"""The installer from a clone, with a package index in the place of the network."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.box.installed import REPOSITORY
from tests.box.machine import Machine

pytestmark = pytest.mark.systemd

SOURCES = ("pyproject.toml", "README.md", "LICENSE", "deploy", "gateway", "schemas")
INDEX = "http://127.0.0.1:8000/"


def clone(to: Path) -> None:
    """Clone this repository, with the changes that are not committed yet."""
    subprocess.run(["git", "clone", "--quiet", str(REPOSITORY), str(to)], check=True)
    for name in SOURCES:
        if (REPOSITORY / name).is_file():
            shutil.copy(REPOSITORY / name, to)
        else:
            shutil.rmtree(to / name)
            shutil.copytree(REPOSITORY / name, to / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))


def index(to: Path, python: Path) -> None:
    """Fill a folder with a package index: what deploy/lock names, in one folder for each package."""
    locks = [f"--requirement={REPOSITORY}/deploy/lock/{name}.txt" for name in ("build", "requirements")]
    fetched = to / "fetched"
    fetch = [str(python), "-m", "pip", "download", "--quiet", "--no-deps", "--require-hashes", f"--dest={fetched}"]
    fetched_all = subprocess.run([*fetch, *locks], capture_output=True, text=True, check=False, timeout=300)
    assert fetched_all.returncode == 0, fetched_all.stdout + fetched_all.stderr
    for path in fetched.iterdir():
        package = re.sub(r"[-_.]+", "-", path.name.split("-")[0]).lower()
        (to / package).mkdir(exist_ok=True)
        path.rename(to / package / path.name)
    fetched.rmdir()


def test_from_a_clone_and_from_a_wheel_over_a_package_index(bare: Machine, wheels: Path) -> None:
    """As on a robot with a network: `sudo deploy/install.sh` in a clone, then an upgrade by a wheel of pip's."""
    box = bare.box
    clone(box.shared / "clone")
    index(box.shared / "index", wheels.parent / "venv/bin/python")
    box.write("/etc/pip.conf", f"[global]\nindex-url = {INDEX}\n")
    box.run("systemd-run", "/usr/bin/python3", "-m", "http.server", "--directory=/box-out/index", "--bind=127.0.0.1")
    box.run("bash", "-c", "until (: </dev/tcp/127.0.0.1/8000) 2>/dev/null; do sleep 0.1; done")

    installer = ("/box-out/clone/deploy/install.sh", "--framing", "plain")
    promised = box.run(*installer, "--dry-run").stdout
    assert "from /box-out/clone and the network, with the hashes of the lock\n" in promised
    assert box.run(*installer, timeout_s=300).stdout == promised
    bare.simulate()
    assert "accepted" in bare.send()
    first = bare.venv()
    committed_s = int(box.run("git", "-C", "/box-out/clone", "log", "-1", "--format=%ct").stdout)
    assert int(box.read(f"{first}/commit-time")) == committed_s // 2 * 2, "a wheel's times have even seconds"
    assert f"keep {first}: the same Python" in box.run(*installer, timeout_s=300).stdout

    (own,) = box.run("sh", "-c", f"ls {bare.wheels}/hexapod_gateway-*.whl").stdout.split()
    upgrade = (*installer, "--own-wheel", own, "--force")
    promised = box.run(*upgrade, "--dry-run").stdout
    assert box.run(*upgrade, timeout_s=300).stdout == promised
    assert bare.venv() != first
    assert box.read(f"{bare.venv()}/commit-time")
    assert "accepted" in bare.send()
