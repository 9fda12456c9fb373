"""A run of the tests that is interrupted leaves no process behind: no console that listens, no box, no terminal."""

import os
import select
import shutil
import signal
import sys
from pathlib import Path

import pytest

from tests.support import descendants
from tests.support.child import Child
from tests.support.descendants import Run
from tests.support.interrupted_scene import READY

pytestmark = pytest.mark.full

PYTEST = (sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/support/interrupted_scene.py")
STAGE = """
import subprocess, sys
from tests.support.descendants import Run
with Run() as run:
    run.pass_on()
    sys.exit(subprocess.run(sys.argv[1:], check=False, process_group=0).returncode)
"""
"""What `python -m tests` does with a stage."""
HOW = {"alone": PYTEST, "worker": (*PYTEST, "-n", "1"), "stage": (sys.executable, "-c", STAGE, *PYTEST, "-n", "1")}
LATE_S = 60.0
HELD = ("gateway\0console", "sleep\0", *(["tmux"] if shutil.which("tmux") else []))


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Run:
    """All that this test starts."""
    monkeypatch.setenv(descendants.MARK, os.environ[descendants.MARK])  # as it was, afterwards
    return Run()


@pytest.mark.parametrize(
    ("how", "number"), [("alone", signal.SIGTERM), ("worker", signal.SIGINT), ("stage", signal.SIGTERM)]
)
def test_nothing_is_left(how: str, number: signal.Signals, run: Run, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "ready")
    ready = os.open(tmp_path / "ready", os.O_RDWR)
    # ZYGOTE=no: each program has a command line of its own, by which it is looked for.
    with Child(HOW[how], {**os.environ, "ZYGOTE": "no", READY: str(tmp_path / "ready")}) as tests:
        assert select.select([ready], [], [], LATE_S)[0], str(tests)
        os.close(ready)
        held = "".join(Path(f"/proc/{pid}/cmdline").read_text() for pid in run.processes())
        assert all(each in held for each in HELD), held
        tests.send_signal(number)
        assert tests.wait(LATE_S) != 0
        assert run.processes() == set(), str(tests)
