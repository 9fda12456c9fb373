"""The mutants fit the code as it is, and the runner tells what a test notices from what none does."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.mutants.__main__ import LEAST_KILLED, ROOT
from tests.mutants.lists import SUBJECTS
from tests.mutants.mutant import Mutant, Subject, check, mutated
from tests.mutants.workers import Outcome, Workers


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.file)
def test_they_fit_the_code_as_it_is(subject: Subject) -> None:
    """Where one does not, the code has changed: change its `old`, or make a new one for what stands there now."""
    check(subject, ROOT)
    for test in subject.tests:
        assert (ROOT / test).is_file()


def test_few_are_taken_for_equivalent() -> None:
    mutants = [mutant for subject in SUBJECTS for mutant in subject.mutants]
    assert sum(mutant.equivalent == "" for mutant in mutants) >= LEAST_KILLED * len(mutants)


@pytest.mark.parametrize("old", ["c = 1", "a", "b"], ids=["not there", "twice", "unchanged"])
def test_one_that_does_not_fit_is_an_error(old: str) -> None:
    with pytest.raises(ValueError, match=r"stands|changes nothing"):
        mutated("a = 1\na + b\n", Mutant(old, "b", "…"))


FILES = {
    "gateway/__init__.py": "",
    "gateway/sums.py": "def add(a, b):\n    return a + b\n\n\ndef name():\n    return 'sum'\n",
    "tests/__init__.py": "",
    "tests/test_sums.py": "from gateway.sums import add\n\n\ndef test_add():\n    assert add(2, 3) == 5\n",
}
OUTCOMES = {
    Mutant("a + b", "a - b", "noticed"): Outcome.KILLED,
    Mutant("'sum'", "'product'", "not noticed"): Outcome.SURVIVED,
    Mutant("    return a + b", "    while True: pass", "never ends"): Outcome.TIMED_OUT,
    Mutant("a + b", "__import__('os').abort()", "crashes"): Outcome.KILLED,
    Mutant("def add", "raise OSError\ndef add", "not even begun"): Outcome.BROKEN,
    Mutant("return a + b", "return b + a", "after all these, the file is as it was"): Outcome.SURVIVED,
}


def judge_a_small_tree(folder: Path) -> None:
    """In a process without threads, for it forks: print what became of each, as `KIND why`."""
    for name, text in FILES.items():
        path = folder / "root" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    subject = Subject("gateway/sums.py", ("tests/test_sums.py",), tuple(OUTCOMES))
    workers = Workers(folder / "root", folder / "copies", 2, timeout_s=5)
    if workers.without_mutant(subject.tests) is not Outcome.SURVIVED:
        print(workers.output)
    for _, mutant, outcome in workers.run((subject, mutant) for mutant in OUTCOMES):
        print(outcome.name, mutant.why)


def test_what_became_of_each(tmp_path: Path) -> None:
    script = f"from pathlib import Path; import {__name__} as m; m.judge_a_small_tree(Path({str(tmp_path)!r}))"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False)
    assert sorted(done.stdout.splitlines()) == sorted(f"{o.name} {m.why}" for m, o in OUTCOMES.items()), done.stderr
    assert (tmp_path / "copies/0/gateway/sums.py").read_text() == FILES["gateway/sums.py"]
