"""`python -m tests.mutants [PART OF A FILE'S NAME …]`: does a test fail for each mutant?

The tree is copied, a folder for each worker. One mutant at a time is written into it, and its subject's tests run until
the first fails, in a process that is forked with all libraries loaded already: a quarter of a second for most. Ends
with 1 where less than 95 % are killed, or where one survives that is not listed as equivalent.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

from tests.mutants.lists import SUBJECTS
from tests.mutants.mutant import Mutant, Subject, check
from tests.mutants.workers import Outcome, Workers

ROOT = Path(__file__).parents[2]
LEAST_KILLED = 0.95
TESTS_MAY_TAKE_S = 120.0


def main() -> int:
    """Run all mutants, or those of the files that are named in part. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="make mutants", description="Does a test fail for each mutant?")
    parser.add_argument("names", nargs="*", help="only files whose name has one of these in it")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    subjects = [s for s in SUBJECTS if not arguments.names or any(name in s.file for name in arguments.names)]
    for subject in subjects:
        check(subject, ROOT)
    begun = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        workers = Workers(ROOT, Path(folder), arguments.workers)
        if not tests_are_good(workers, subjects):
            return 1
        good = judge(workers, subjects)
    print(f"{time.monotonic() - begun:.0f} s in all")
    return 0 if good else 1


def tests_are_good(workers: Workers, subjects: list[Subject]) -> bool:
    """Whether the tests pass without any mutant, and soon enough."""
    files = tuple(dict.fromkeys(test for subject in subjects for test in subject.tests))
    begun = time.monotonic()
    outcome = workers.without_mutant(files)
    took_s = time.monotonic() - begun
    print(
        f"{len(files)} files of tests take {took_s:.0f} s without a mutant, at most {TESTS_MAY_TAKE_S:.0f}", flush=True
    )
    if outcome is not Outcome.SURVIVED:
        print(f"they do not pass, so they can judge nothing:\n{workers.output}")
    return outcome is Outcome.SURVIVED and took_s <= TESTS_MAY_TAKE_S


def judge(workers: Workers, subjects: list[Subject]) -> bool:
    """Run the mutants and say what became of them. Returns whether that is good enough."""
    todo = [(subject, mutant) for subject in subjects for mutant in subject.mutants]
    killed, wrong = 0, []
    for done, (subject, mutant, outcome) in enumerate(workers.run(todo), start=1):
        killed += outcome in (Outcome.KILLED, Outcome.TIMED_OUT)
        line = f"[{done}/{len(todo)}] {outcome:9} {subject.file}: {in_short(mutant)}"
        print(line + (f"  (equivalent: {mutant.equivalent})" if mutant.equivalent else ""), flush=True)
        expected = Outcome.SURVIVED if mutant.equivalent else Outcome.KILLED
        if outcome is not expected and not (outcome is Outcome.TIMED_OUT and not mutant.equivalent):
            wrong.append(f"{outcome:9} {subject.file}: {mutant.why}\n  - {mutant.old}\n  + {mutant.new}")
    print(f"\n{killed} of {len(todo)} killed ({killed / max(1, len(todo)):.1%})")
    if wrong:
        print("Not as they ought to be (an equivalent one that is killed is none; a broken one proves nothing):")
        print("\n".join(wrong))
    return not wrong and killed >= LEAST_KILLED * len(todo)


def in_short(mutant: Mutant) -> str:
    """A line about it."""
    old, new = (" ".join(text.split()) for text in (mutant.old, mutant.new))
    return f"{old[:50]!r} → {new[:50]!r}"


if __name__ == "__main__":
    sys.exit(main())
