"""Runs a file's tests against its mutants: a forked process for each, in which the libraries are loaded already.

The process imports the mutant in the place of the file, and the tests, up to the first that fails. A test that noticed
a mutant comes first for the next, then the quick ones.
"""

import ctypes
import importlib
import importlib.util
import json
import os
import resource
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from importlib.machinery import SourceFileLoader
from math import ceil
from pathlib import Path
from types import CodeType
from typing import Final, NoReturn

import pytest
from hypothesis import Phase, settings

LIBRARIES: Final = (
    *("async_solipsism", "asyncio", "cryptography.x509", "hypothesis.stateful", "hypothesis.strategies"),
    *("multiprocessing.pool", "prometheus_client", "pydantic", "rich", "typer", "zenoh"),
    *("schemas.calibration", "schemas.command", "schemas.keys", "schemas.lease", "schemas.gateway_state"),
)
"""What takes long to import, and knows nothing of what is judged. None of it starts a thread: the process can fork."""
OURS: Final = ("gateway", "tests")
MEMORY_BYTES: Final = 8 << 30
"""A fault that never ends may also take memory without end."""
_SIGNAL_WHEN_THE_PARENT_ENDS: Final = 1
"""PR_SET_PDEATHSIG of prctl(2)."""


class Outcome(StrEnum):
    KILLED = "killed"
    TIMED_OUT = "timed out"
    SURVIVED = "survived"
    INCOMPETENT = "incompetent"
    """The tests could not even begin: not a fault that somebody makes and does not see. It does not count."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """The fate of a mutant, and the test that noticed it."""

    outcome: Outcome
    test: str = ""


class TestsFailError(Exception):
    """The tests fail without any mutant, so they can judge nothing."""


@dataclass(frozen=True, slots=True)
class Subject:
    """A file of a tree, the tests that judge it, and the files to judge in its place."""

    root: Path
    file: str
    tests: tuple[str, ...]
    mutated: tuple[str, ...]

    @property
    def module(self) -> str:
        """Return the module's name in Python."""
        return self.file.removesuffix(".py").replace("/", ".")


@dataclass(frozen=True, slots=True)
class _Limits:
    """Seconds of the processor, and in all: what waits for ever uses no processor.

    Of a mutant by what the tests take without one, since the machine may be busy.
    """

    processor_s: float = 300
    all_s: float = 3600


def verdicts(subject: Subject) -> Iterator[Verdict]:
    """Judge the mutants, in their order. Raises TestsFailError."""
    for library in LIBRARIES:
        if importlib.util.find_spec(library.partition(".")[0]):
            importlib.import_module(library)
    begun_s, used_s = time.monotonic(), _children_used_s()
    without, took_s = _judged(subject, None, [], _Limits())
    if without.outcome is not Outcome.SURVIVED:
        raise TestsFailError(without.test or without.outcome)
    used_s, all_s = _children_used_s() - used_s, time.monotonic() - begun_s
    limits = _Limits(5 + 4 * used_s, 15 + 6 * all_s)
    order = sorted(took_s, key=took_s.__getitem__)
    for mutated in subject.mutated:
        verdict, _ = _judged(subject, mutated, order, limits)
        if verdict.test in order:
            order.insert(0, order.pop(order.index(verdict.test)))
        yield verdict


def _judged(
    subject: Subject, mutated: str | None, order: list[str], limits: _Limits
) -> tuple[Verdict, dict[str, float]]:
    """Return the verdict by tests in this order, and how long each of them took."""
    notes, parent = os.memfd_create("notes"), os.getpid()
    pid = os.fork()
    if pid == 0:
        ctypes.CDLL(None).prctl(_SIGNAL_WHEN_THE_PARENT_ENDS, signal.SIGKILL)
        if os.getppid() != parent:  # it has ended before that
            os._exit(1)
        resource.setrlimit(resource.RLIMIT_CPU, (ceil(limits.processor_s), ceil(limits.processor_s) + 5))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
        signal.setitimer(signal.ITIMER_REAL, limits.all_s)
        if mutated is not None:
            _import_instead(subject, mutated)
        _run_tests(subject, _Tests(notes, order))
    _, status = os.waitpid(pid, 0)
    with open(notes, encoding="utf-8") as lines:
        lines.seek(0)
        ended = [json.loads(line) for line in lines]
    failed = next((test for test, _, fails in ended if fails), "")
    return _verdict(os.waitstatus_to_exitcode(status), failed), {test: took_s for test, took_s, _ in ended}


def _import_instead(subject: Subject, mutated: str) -> None:
    """Let an import of the subject's file load this source."""
    own, file = SourceFileLoader.get_code, str(subject.root / subject.file)

    def get_code(loader: SourceFileLoader, name: str) -> CodeType | None:
        return compile(mutated, file, "exec") if name == subject.module else own(loader, name)

    SourceFileLoader.get_code = get_code  # type: ignore[assignment, method-assign]


def _verdict(code: int, test: str) -> Verdict:
    """Return the verdict for pytest's exit code: 0 if all pass, 1 if one fails. A fault may crash it (a signal)."""
    if code in (-signal.SIGXCPU, -signal.SIGALRM):
        return Verdict(Outcome.TIMED_OUT)
    if code == 0:
        return Verdict(Outcome.SURVIVED)
    return Verdict(Outcome.KILLED if code == 1 or code < 0 else Outcome.INCOMPETENT, test)


def _run_tests(subject: Subject, plugin: "_Tests") -> NoReturn:
    """Import all of ours anew, and end with what pytest ends with."""
    code = int(pytest.ExitCode.INTERNAL_ERROR)
    try:
        nothing = os.open(os.devnull, os.O_RDWR)
        for standard in (0, 1, 2):
            os.dup2(nothing, standard)
        os.chdir(subject.root)
        sys.path[0] = str(subject.root)
        sys.dont_write_bytecode = True  # a mutant's would be taken for the file's
        for name in [name for name in sys.modules if name.partition(".")[0] in OURS]:
            del sys.modules[name]
        options = ["-x", "-q", "--capture=sys", "-p", "no:cacheprovider"]
        options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
        code = int(pytest.main([*subject.tests, *options], plugins=[plugin]))
    finally:
        os._exit(code)


@dataclass(slots=True, eq=False)  # pytest hashes its plugins
class _Tests:
    """A plugin for pytest: Hypothesis tries the same examples each time, and looks for no nicer ones."""

    notes: int
    """Where to write each test, how long it took, and whether it has failed."""
    order: list[str]

    @pytest.hookimpl(trylast=True)
    def pytest_configure(self) -> None:
        """Set Hypothesis's profile, after tests/conftest.py has chosen its own."""
        phases = [Phase.explicit, Phase.generate]
        settings.register_profile("mutants", settings(), derandomize=True, database=None, phases=phases)
        settings.load_profile("mutants")

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        ranks = {test: rank for rank, test in enumerate(self.order)}
        items.sort(key=lambda item: ranks.get(item.nodeid, len(ranks)))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note the end of a part of a test: its preparation, itself, or its teardown."""
        if report.failed or report.when == "call":
            os.write(self.notes, f"{json.dumps([report.nodeid, report.duration, report.failed])}\n".encode())


def _children_used_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
