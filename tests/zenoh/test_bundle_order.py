"""Which of two releases is older: by PEP 440's order, and by their commits' times where the numbers are equal."""

import itertools
import subprocess
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ORDER = (
    "1.1.9",
    "1.2.0.dev1",
    "1.2.0a1.dev1",
    "1.2.0a1",
    "1.2.0a10",
    "1.2.0b2",
    "1.2.0rc1.post0.dev1",
    "1.2.0rc1.post0",
    "1.2.0rc2",
    "1.2.0",
    "1.2.0.post0",
    "1.2.0.post1.dev2",
    "1.2.0.post1",
    "1.2.1",
    "1.10.0",
)
When = tuple[int, int, int, int, int, int]
WHEN = (2026, 1, 1, 12, 0, 0)
LATER = (2026, 1, 1, 12, 0, 2)
BEGIN = """
ETC=/etc OPT=$1 NAME=hexapod-gateway HERE=deploy wheels=$1/wheels
bundle=BUNDLE allow_downgrade=no python=/usr/bin/python3
fail() { echo "$*"; exit 1; }
. deploy/venv.sh
. deploy/bundle.sh
"""
PAIRS = """
while read -r older newer; do
    ! is_older "$older" "$newer" && is_older "$newer" "$older" || echo "$older $newer"
done
"""
CHECK = """
[ -z "$2" ] || time_of "$2" >"$OPT/venv/commit-time"
check_not_older
"""


def run(script: str, *arguments: str, lines: str = "") -> str:
    """What functions of the installer print."""
    command = ["bash", "-euo", "pipefail", "-c", BEGIN + script, "bash", *arguments]
    done = subprocess.run(command, cwd=ROOT, input=lines, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    return done.stdout


def test_versions_have_the_order_of_pep_440() -> None:
    pairs = "".join(f"{older} {newer}\n" for older, newer in itertools.pairwise(ORDER))
    assert run(PAIRS, "/nonexistent", lines=pairs) == ""


def wheel(folder: Path, version: str, when: When) -> Path:
    folder.mkdir(parents=True)
    path = folder / f"hexapod_gateway-{version}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as made:
        made.writestr(zipfile.ZipInfo("gateway/__init__.py", when), "")
    return path


@pytest.mark.parametrize(
    ("present", "was", "offered", "comes", "is_taken"),
    [
        ("1.2.0", WHEN, "1.2.0rc1", LATER, False),
        ("1.2.0+g4aa0d07", LATER, "1.2.0+gffffff1", WHEN, False),
        ("1.2.0+gffffff1", WHEN, "1.2.0+g4aa0d07", LATER, True),
        ("1.2.0", WHEN, "1.2.0", WHEN, True),
        ("1.2.0", None, "1.2.0+g4aa0d07", WHEN, True),
        ("1.2.0rc1", LATER, "1.2.0", WHEN, True),
    ],
)
def test_of_equal_numbers_the_older_commit_is_rejected(
    tmp_path: Path, present: str, was: When | None, offered: str, comes: When, is_taken: bool
) -> None:
    """None: an installer of before has kept no time, and nobody knows."""
    installed = tmp_path / f"venv/lib/python3.11/site-packages/hexapod_gateway-{present}.dist-info"
    installed.mkdir(parents=True)
    wheel(tmp_path / "wheels", offered, comes)
    said = run(CHECK, str(tmp_path), "" if was is None else str(wheel(tmp_path / "was", present, was)))
    says = f"BUNDLE has release {offered}, and {present} is installed, which is newer; if that is meant: --allow-"
    assert said == ("" if is_taken else f"{says}downgrade\n")
