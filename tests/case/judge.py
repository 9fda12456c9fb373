"""Each piece of evidence: shown, red, or a person's; with a sentence that says why."""

import ast
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

from gateway.people.tools.drill.steps import STEPS
from tests.case import extended, program
from tests.case.case import ROOT, SEARCH, Bench, Claim, Figure, Kernel, Model, Mutants
from tests.case.extended import Shown
from tests.case.kernel import Report
from tests.case.left import Outcome, mark
from tests.kernel.inside.scenes import SCENES
from tests.support import schedule
from tests.unit.test_docs import headings

SCORES: Final = ROOT / "tests" / "mutants" / "scores.json"


class Verdict(StrEnum):
    """What becomes of a piece of evidence, and of a claim."""

    SHOWN = "shown"
    PERSON = "a person must"
    RED = "red"

    @property
    def worse(self) -> int:
        return list(Verdict).index(self)


class Judged(NamedTuple):
    """One piece of evidence, or a claim's section."""

    verdict: Verdict
    evidence: str
    why: str = ""


class Ran(NamedTuple):
    """What is known of these files."""

    tests: Mapping[str, Sequence[Outcome]] | None
    """None: nobody ran them for these files."""
    bench: Sequence[Mapping[str, Any]] | None
    scores: Mapping[str, Mapping[str, Any]]
    kernel: Report | None = None
    """The last run of `make kernel`, of whichever files."""
    extended: Mapping[str, Shown] = {}
    """What `make test-all` last showed of the tests that `make test` leaves out."""
    judges: Mapping[str, Sequence[str]] = {}
    """What each of these judges."""


def judge(claim: Claim, ran: Ran) -> list[Judged]:
    """The claim's section, and all of its evidence."""
    return [
        _section(claim.section),
        *(_test(test, ran) for test in claim.tests),
        *(_promise(model, ran) for model in claim.model),
        *(_score(mutants, ran) for mutants in claim.mutants),
        *(_figure(figure, ran) for figure in claim.figures),
        *(_bench(bench, ran) for bench in claim.bench),
        *(_kernel(kernel, ran) for kernel in claim.kernel),
        *(_drill(step) for step in claim.drill),
        *(Judged(Verdict.PERSON, person.check, person.how) for person in claim.person),
    ]


def is_shown(test: str, ran: Ran) -> bool:
    """Whether this test, which a claim names, needs no run."""
    return _test(test, ran).verdict is Verdict.SHOWN


def worst(judged: Sequence[Judged]) -> Verdict:
    """A claim is as good as its worst evidence."""
    return max((each.verdict for each in judged), key=lambda verdict: verdict.worse)


# ---- the kinds of evidence


def _section(section: str) -> Judged:
    page, _, heading = section.partition("#")
    path = ROOT / page
    if not path.is_file():
        return Judged(Verdict.RED, section, "there is no such document")
    if heading not in headings(path):
        return Judged(Verdict.RED, section, "the document has no such section")
    return Judged(Verdict.SHOWN, section)


def _test(test: str, ran: Ran) -> Judged:
    path, _, name = test.partition("::")
    if name not in _defined(ROOT / path):
        return Judged(Verdict.RED, test, "there is no such test")
    found = (ran.tests or {}).get(test, ())
    if not found and schedule.is_extended(test):
        return _recorded(test, ran)
    if ran.tests is None:
        return Judged(Verdict.RED, test, "it was not run for these files: make test, or make case RUN=yes")
    if not found:
        return Judged(Verdict.RED, test, "it was left out of the run")
    return _outcome(test, found)


def _outcome(test: str, found: Sequence[Outcome]) -> Judged:
    """The worst of what became of its parameters."""
    bad = [outcome for outcome in found if outcome.result not in {"passed", "flaky"}]
    if bad:
        return Judged(Verdict.RED, test, f"{bad[0].name} {bad[0].result}{_more(len(bad) - 1)}")
    flaky = [outcome for outcome in found if outcome.result == "flaky"]
    if flaky:
        why = f"{flaky[0].name} failed beside others and passed alone{_more(len(flaky) - 1)}: find out why"
        return Judged(Verdict.PERSON, test, why)
    return Judged(Verdict.SHOWN, test, "" if len(found) == 1 else f"{len(found)} times")


def _recorded(test: str, ran: Ran) -> Judged:
    shown = ran.extended.get(test)
    if shown is None:
        return Judged(Verdict.RED, test, "only make test-all runs it, and nobody has: make case RUN=yes")
    if shown.files != extended.digest(test, ran.judges.get(test, ())):
        why = f"it last passed at {shown.commit}; what it judges has changed since: make case RUN=yes, or make test-all"
        return Judged(Verdict.RED, test, why)
    return Judged(Verdict.SHOWN, test, f"at {shown.commit}")


def _more(count: int) -> str:
    return f", and {count} more" if count else ""


@cache
def _defined(path: Path) -> frozenset[str]:
    if not path.is_file():
        return frozenset()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return frozenset(node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def _promise(model: Model, ran: Ran) -> Judged:
    evidence = f"model check: {model.promise}"
    if model.promise not in _promises():
        return Judged(Verdict.RED, evidence, "the model check makes no such promise")
    return Judged(_test(SEARCH, ran).verdict, evidence, _test(SEARCH, ran).why)


@cache
def _promises() -> frozenset[str]:
    """What the model check demands: the last argument of each `demand(…)`, with its blanks as `{name}`."""
    return frozenset(_demanded(ROOT / "tests" / "support"))


def _demanded(folder: Path) -> Iterator[str]:
    for path in folder.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "demand":
                yield re.sub(r"^f?[\"']|[\"']$", "", ast.unparse(node.args[-1]))


def _score(mutants: Mutants, ran: Ran) -> Judged:
    evidence = f"mutants of {mutants.module}: at least {mutants.at_least:g} % noticed"
    found = ran.scores.get(mutants.module)
    if found is None:
        return Judged(Verdict.RED, evidence, "nobody has measured it: make mutants")
    score = float(found["score"])
    if score < mutants.at_least:
        return Judged(Verdict.RED, evidence, f"{score:.1f} %")
    if found["digest"] != program.digest(ROOT / mutants.module):
        return Judged(Verdict.PERSON, evidence, f"{score:.1f} % of an older text of it: make mutants")
    return Judged(Verdict.SHOWN, evidence, f"{score:.1f} %")


def _figure(figure: Figure, ran: Ran) -> Judged:
    evidence = f"{figure.test}: {figure.name} at least {figure.at_least:g}"
    passed = _test(figure.test, ran)
    if passed.verdict is not Verdict.SHOWN:
        return Judged(passed.verdict, evidence, passed.why)
    outcomes = (ran.tests or {}).get(figure.test)
    if outcomes:
        least = min(float(each.figures.get(figure.name, "nan")) for each in outcomes)
    else:
        least = ran.extended[figure.test].figures.get(figure.name, math.nan)
    if not least >= figure.at_least:  # a figure that is missing, too
        return Judged(Verdict.RED, evidence, f"it left {least:g}")
    return Judged(Verdict.SHOWN, evidence, f"{least:g}")


def _bench(bench: Bench, ran: Ran) -> Judged:
    evidence = f"benchmark: {bench.row}"
    if ran.bench is None:
        return Judged(Verdict.PERSON, evidence, "not measured for these files: make bench, on a quiet machine")
    rows = [row for row in ran.bench if str(row["name"]).startswith(bench.row)]
    if not rows:
        return Judged(Verdict.PERSON, evidence, "the benchmark was run without this row")
    if any(row["met"] is None for row in rows):
        return Judged(Verdict.RED, evidence, "the row has no bound")
    why = "; ".join(f"{row['gateway']} ({row['aim']})" for row in rows)
    return Judged(Verdict.SHOWN if all(row["met"] for row in rows) else Verdict.RED, evidence, why)


def _kernel(kernel: Kernel, ran: Ran) -> Judged:
    evidence = f"make kernel: {kernel.scene}"
    if kernel.scene not in SCENES:
        return Judged(Verdict.RED, evidence, "there is no such scene")
    if ran.kernel is None or kernel.scene not in ran.kernel.scenes:
        return Judged(Verdict.PERSON, evidence, "it was not played: make kernel")
    when = f"on {ran.kernel.date}, Linux {ran.kernel.kernel}"
    if not ran.kernel.scenes[kernel.scene]:
        return Judged(Verdict.RED, evidence, f"it did not hold {when}")
    if ran.kernel.files != mark():
        return Judged(Verdict.PERSON, evidence, f"it held {when}, for other files: make kernel")
    return Judged(Verdict.SHOWN, evidence, when)


def _drill(name: str) -> Judged:
    evidence = f"drill: {name}"
    if name not in {step.name for step in STEPS}:
        return Judged(Verdict.RED, evidence, "the drill has no such step")
    return Judged(Verdict.PERSON, evidence, "on this robot: hexapod-gateway drill --report drill.html")
