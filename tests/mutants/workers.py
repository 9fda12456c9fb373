"""Runs tests against mutants: copies of the tree, and forked processes with the libraries loaded already."""

import gc
import importlib
import importlib.util
import os
import shutil
import signal
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

import pytest
from hypothesis import Phase, settings

from tests.mutants.mutant import Mutant, Subject, mutated

TIMEOUT_S: Final = 60.0
"""For one mutant's tests, which take a few seconds: a fault that makes them wait for ever is noticed, too."""
LIBRARIES: Final = (
    *("async_solipsism", "asyncio", "cryptography.x509", "hypothesis.stateful", "hypothesis.strategies"),
    *("multiprocessing.pool", "prometheus_client", "pydantic", "pydantic_settings", "rich", "structlog", "typer"),
    "zenoh",
)
"""What takes long to import. None of it starts a thread, so the process can be forked."""
OURS: Final = ("gateway", "schemas", "tests")


class Outcome(StrEnum):
    """What became of a mutant."""

    KILLED = "killed"
    TIMED_OUT = "timed out"
    SURVIVED = "survived"
    BROKEN = "broken"
    """The tests could not even begin: not a fault that somebody makes and does not see."""


class Repeatable:
    """A plugin for pytest: Hypothesis tries the same examples each time, and looks for no nicer ones."""

    @pytest.hookimpl(trylast=True)
    def pytest_configure(self) -> None:
        """After tests/conftest.py has chosen its profile."""
        phases = [Phase.explicit, Phase.generate]
        settings.register_profile("mutants", settings(), derandomize=True, database=None, phases=phases)
        settings.load_profile("mutants")


@dataclass(slots=True)
class _Run:
    """A mutant under way in one of the trees."""

    tree: Path
    subject: Subject
    mutant: Mutant
    ends_s: float


class Workers:
    """`count` copies of the tree, in each of which one mutant at a time is judged."""

    def __init__(self, root: Path, folder: Path, count: int, timeout_s: float = TIMEOUT_S) -> None:
        for library in LIBRARIES:
            if importlib.util.find_spec(library.partition(".")[0]):
                importlib.import_module(library)
        gc.freeze()
        self._root = root
        self._timeout_s = timeout_s
        self._trees = [folder / str(number) for number in range(count)]
        shutil.copytree(root, self._trees[0], ignore=shutil.ignore_patterns(".*", "__pycache__", "build", "dist"))

    def without_mutant(self, tests: tuple[str, ...]) -> Outcome:
        """Run these tests as they are, in the first tree; then copy it, with all that has been compiled."""
        _, status = os.waitpid(_forked(self._trees[0], tests), 0)
        for tree in self._trees[1:]:
            shutil.copytree(self._trees[0], tree)
        sys.dont_write_bytecode = True  # from now on: a mutant's would be taken for the next one's
        return _outcome(status)

    @property
    def output(self) -> str:
        """What the tests without a mutant said."""
        return (self._trees[0] / "output.txt").read_text(encoding="utf-8", errors="replace")

    def run(self, todo: Iterable[tuple[Subject, Mutant]]) -> Iterator[tuple[Subject, Mutant, Outcome]]:
        """Judge them all, and tell as they finish."""
        free = list(self._trees)
        runs: dict[int, _Run] = {}
        try:
            for subject, mutant in todo:
                if not free:
                    yield self._next_finished(runs, free)
                tree = free.pop()
                path = tree / subject.file
                path.write_text(mutated(path.read_text(encoding="utf-8"), mutant), encoding="utf-8")
                pid = _forked(tree, subject.tests)
                runs[pid] = _Run(tree, subject, mutant, time.monotonic() + self._timeout_s)
            while runs:
                yield self._next_finished(runs, free)
        finally:
            for pid in runs:
                os.killpg(pid, signal.SIGKILL)
                os.waitpid(pid, 0)

    def _next_finished(self, runs: dict[int, _Run], free: list[Path]) -> tuple[Subject, Mutant, Outcome]:
        while True:
            for pid, run in runs.items():
                finished, status = os.waitpid(pid, os.WNOHANG)
                timed_out = not finished and time.monotonic() > run.ends_s
                if finished or timed_out:
                    if timed_out:
                        os.killpg(pid, signal.SIGKILL)
                        os.waitpid(pid, 0)
                    del runs[pid]
                    free.append(run.tree)
                    shutil.copy2(self._root / run.subject.file, run.tree / run.subject.file)
                    return run.subject, run.mutant, Outcome.TIMED_OUT if timed_out else _outcome(status)
            time.sleep(0.005)


def _outcome(status: int) -> Outcome:
    """pytest ends with 0 where all pass and 1 where one fails; a fault may also crash the process (a signal)."""
    code = os.waitstatus_to_exitcode(status)
    if code == 0:
        return Outcome.SURVIVED
    return Outcome.KILLED if code == 1 or code < 0 else Outcome.BROKEN


def _forked(tree: Path, tests: tuple[str, ...]) -> int:
    """Run tests in this tree, in a process and process group of its own. Returns its id."""
    pid = os.fork()
    if pid == 0:
        code = 70
        try:
            os.setpgid(0, 0)
            output = os.open(tree / "output.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.dup2(output, 1)
            os.dup2(output, 2)
            os.chdir(tree)
            sys.path[0] = str(tree)
            for name in [name for name in sys.modules if name.partition(".")[0] in OURS]:
                del sys.modules[name]
            arguments = [
                *tests,
                "-x",
                "-q",
                "-p",
                "no:cacheprovider",
                "-W",
                "ignore::pytest.PytestAssertRewriteWarning",
            ]
            code = int(pytest.main(arguments, plugins=[Repeatable()]))
            sys.stdout.flush()
        finally:
            os._exit(code)
    with suppress(OSError):  # whichever of the two comes first: a kill needs the group
        os.setpgid(pid, pid)
    return pid
