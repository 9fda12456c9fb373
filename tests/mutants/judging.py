"""Runs a file's tests against its mutants: a forked process for each, in which all is loaded already.

The tests are imported once for each file. A mutant is put in the place of what is loaded, so that it costs little more
than the tests up to the first that fails; a test that noticed one comes first for the next. What changes more than one
function, or one that is called while modules are imported, is judged by a process that imports all anew.
"""

import gc
import importlib
import importlib.util
import json
import os
import resource
import select
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from enum import StrEnum
from math import ceil
from pathlib import Path
from types import CodeType, FrameType
from typing import Final, NoReturn

import pytest
from hypothesis import Phase, settings

from tests.mutants.exchange import MutatedImport, in_place, watched

LIBRARIES: Final = (
    *("async_solipsism", "asyncio", "cryptography.x509", "hypothesis.stateful", "hypothesis.strategies"),
    *("multiprocessing.pool", "prometheus_client", "pydantic", "rich", "typer", "zenoh"),
    *("schemas.calibration", "schemas.command", "schemas.keys", "schemas.lease", "schemas.telemetry"),
)
"""What takes long to import, and knows nothing of what is judged. None of it starts a thread: the process can fork."""
OURS: Final = ("gateway", "tests")
MEMORY_BYTES: Final = 8 << 30
"""A fault that never ends may also take memory without end."""


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
    """Seconds of the processor, in all, and of one test: what waits for ever uses no processor.

    Of a mutant by what the tests take without one, since the machine may be busy.
    """

    processor_s: float = 300
    all_s: float = 3600
    test_s: float = 900


def verdicts(subject: Subject) -> Iterator[tuple[int, Verdict]]:
    """Judge the mutants; each comes with its number as soon as it is known. Raises TestsFailError."""
    for library in LIBRARIES:
        if importlib.util.find_spec(library.partition(".")[0]):
            importlib.import_module(library)
    anew: list[int] = []
    order: list[str] = []
    limits = _Limits()
    loader, pipe = _forked(None)
    if loader == 0:
        os.setpgid(0, 0)
        _run_tests(subject, _Loaded(-1, limits, subject, pipe))
    try:
        with open(pipe, encoding="utf-8") as lines:
            for line in lines:
                match json.loads(line):
                    case {"fails": test}:
                        raise TestsFailError(test)
                    case {"limits": of_mutants}:
                        limits = _Limits(*of_mutants)
                    case {"order": tests}:
                        order = tests
                    case {"number": number, "outcome": None}:
                        anew.append(number)
                    case {"number": number, "outcome": outcome, "test": test}:
                        yield number, Verdict(Outcome(outcome), test)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(loader, signal.SIGKILL)
        os.waitpid(loader, 0)
    yield from ((number, _judged_anew(subject, number, order, limits)) for number in anew)


def _judged_anew(subject: Subject, number: int, order: list[str], limits: _Limits) -> Verdict:
    """Return the verdict by tests in this order. The test that notices the mutant becomes the first."""
    pid, pipe = _forked(limits)
    if pid == 0:
        file = str(subject.root / subject.file)
        sys.meta_path.insert(0, MutatedImport(subject.module, file, subject.mutated[number]))
        _run_tests(subject, _Anew(pipe, limits, order))
    verdict = _awaited(pid, pipe, limits)
    if verdict.test in order:
        order.insert(0, order.pop(order.index(verdict.test)))
    return verdict


def _forked(limits: _Limits | None) -> tuple[int, int]:
    """The process's id and what to read of it; in that process 0, and where to write."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid:
        os.close(writing)
        return pid, reading
    os.close(reading)
    if limits is not None:
        resource.setrlimit(resource.RLIMIT_CPU, (ceil(limits.processor_s), ceil(limits.processor_s) + 5))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    return 0, writing


def _awaited(pid: int, pipe: int, limits: _Limits) -> Verdict:
    """pytest ends with 0 where all pass and 1 where one fails; a fault may also crash the process (a signal)."""
    ends = os.pidfd_open(pid)
    with open(pipe, encoding="utf-8") as tests:
        in_time, _, _ = select.select([ends], [], [], limits.all_s)
        if not in_time:
            os.kill(pid, signal.SIGKILL)
        _, status = os.waitpid(pid, 0)
        os.close(ends)
        test = tests.readline().strip() if in_time else ""
    code = os.waitstatus_to_exitcode(status)
    if not in_time or code in (-signal.SIGXCPU, -signal.SIGALRM):
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

    pipe: int
    """Where to write the name of the test that fails."""
    limits: _Limits

    def pytest_runtest_logstart(self) -> None:
        """A test begins; one that waits for ever ends all."""
        signal.setitimer(signal.ITIMER_REAL, self.limits.test_s)

    @pytest.hookimpl(trylast=True)
    def pytest_configure(self) -> None:
        """After tests/conftest.py has chosen its profile."""
        phases = [Phase.explicit, Phase.generate]
        settings.register_profile("mutants", settings(), derandomize=True, database=None, phases=phases)
        settings.load_profile("mutants")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A test has failed, or its preparation."""
        if report.failed:
            os.write(self.pipe, f"{report.nodeid}\n".encode())


@dataclass(slots=True, eq=False)  # pytest hashes its plugins
class _Anew(_Tests):
    """Runs the tests for an imported mutant: first those that noticed others, then the quick ones."""

    order: list[str]

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Order the tests; those whose parameters' names the mutant has changed come last."""
        ranks = {test: rank for rank, test in enumerate(self.order)}
        items.sort(key=lambda item: ranks.get(item.nodeid, len(ranks)))


@dataclass(slots=True, eq=False)  # pytest hashes its plugins
class _Loaded(_Tests):
    """Once the tests are collected: a process for each mutant, which goes on where this one stands."""

    subject: Subject
    report: int
    """A pipe's end, for what became of each."""
    imported: set[CodeType] = field(default_factory=set)
    """The subject's functions that are called while modules are imported."""
    now: set[int] = field(default_factory=set)
    """The functions that the present test has called, by first line."""
    took_s: float = 0
    """How long the present test has taken."""
    noted: int | None = None
    """Where to write the above at the end, in the process that runs the tests without a mutant."""
    killers: list[str] = field(default_factory=list)
    """Tests that noticed a mutant, the last one first."""

    def pytest_sessionstart(self) -> None:
        """Look at what importing calls."""
        file = str(self.subject.root / self.subject.file)

        def look(frame: FrameType, event: str, _: object) -> None:
            if event == "call" and frame.f_code.co_filename == file:
                self.imported.add(frame.f_code)

        sys.setprofile(look)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """None, in a mutant's process: pytest runs the tests. True: they have run, there."""
        sys.setprofile(None)
        gc.collect()
        gc.freeze()
        source = (self.subject.root / self.subject.file).read_text(encoding="utf-8")
        module = sys.modules[self.subject.module]
        begun_s, used_s = time.monotonic(), _children_used_s()
        noted = os.memfd_create("calls")
        pid, self.pipe = _forked(self.limits)
        if pid == 0:
            self.noted = noted
            for look in watched(module, source, self.now.add):
                look()
            return None
        without = _awaited(pid, self.pipe, self.limits)
        if without.outcome is not Outcome.SURVIVED:
            _tell(self.report, fails=without.test or without.outcome)
            return True
        with open(noted, encoding="utf-8") as lines:
            lines.seek(0)
            notes = [json.loads(line) for line in lines]
        used_s, took_s = _children_used_s() - used_s, time.monotonic() - begun_s
        longest_s = max((float(note[1]) for note in notes), default=0.0)
        self.limits = limits = _Limits(5 + 4 * used_s, 15 + 6 * took_s, 15 + 6 * longest_s)
        _tell(self.report, limits=[limits.processor_s, limits.all_s, limits.test_s])
        calls = {test: called for test, _, called in notes}
        quick_first = [test for test, _, _ in sorted(notes, key=lambda note: float(note[1]))]
        for number, mutated in enumerate(self.subject.mutated):
            exchange = in_place(module, source, mutated)
            if exchange is None or self.imported & {each.__code__ for each in exchange.functions}:
                _tell(self.report, number=number, outcome=None)
                continue
            tests = [item for item in session.items if exchange.place[1] in calls[item.nodeid]]
            pid, self.pipe = _forked(limits)
            if pid == 0:
                exchange()
                ranks = {test: rank for rank, test in enumerate(dict.fromkeys([*self.killers, *quick_first]))}
                session.items[:] = sorted(tests, key=lambda item: ranks[item.nodeid])
                return None
            verdict = _awaited(pid, self.pipe, limits)
            if verdict.test:
                self.killers = [verdict.test, *(test for test in self.killers if test != verdict.test)]
            _tell(self.report, number=number, outcome=verdict.outcome, test=verdict.test)
        _tell(self.report, order=list(dict.fromkeys([*self.killers, *quick_first])))
        return True

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A part of a test has ended: its preparation, itself, or the tidying after it."""
        _Tests.pytest_runtest_logreport(self, report)
        self.took_s += report.duration

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        if self.noted is not None:
            os.write(self.noted, f"{json.dumps([nodeid, self.took_s, sorted(self.now)])}\n".encode())
            self.now.clear()
            self.took_s = 0


def _children_used_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _tell(pipe: int, **what: object) -> None:
    os.write(pipe, f"{json.dumps(what)}\n".encode())
