"""`python -m tests.mutants [PART OF A FILE'S NAME …]`: does a test fail for each mutant?

Prints what survives and a score for each file, and keeps the scores in scores.json. Ends with 1 where a mutant survives
that is not accepted, or where an accepted one is none any more.
"""

import argparse
import json
import subprocess
import sys
import time
from collections import Counter
from hashlib import sha256
from pathlib import Path
from typing import Final

from tests.case import program
from tests.mutants.by_hand import made_by_hand
from tests.mutants.generated import accepted, mutants_of
from tests.mutants.judges import JUDGES
from tests.mutants.judging import Outcome, Subject, TestsFailError, verdicts

ROOT: Final = Path(__file__).parents[2]
SCORES: Final = Path(__file__).with_name("scores.json")


def main() -> int:
    """Judge all mutants, or those of the files that are named in part. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="make mutants", description="Does a test fail for each mutant?")
    parser.add_argument("names", nargs="*", help="only files whose name has one of these in it")
    parser.add_argument("--accepted", action="store_true", help="run those that are accepted: is one noticed by now?")
    parser.add_argument("--sample", type=int, metavar="N", help="of each file only these many, always the same ones")
    arguments = parser.parse_args()
    files = [file for file in JUDGES if not arguments.names or any(name in file for name in arguments.names)]
    # Not a list that ends early: a survivor in one file hides none in the next.
    scores = [judge(file, run_accepted=arguments.accepted, sample=arguments.sample) for file in files]
    killed, wanted = (sum(score[of] for score in scores) for of in ("killed", "wanted"))
    print(f"\n{killed} of {wanted} killed ({killed / max(1, wanted):.1%}) in {len(files)} files")
    return 0 if all(score["right"] for score in scores) else 1


def judge(file: str, *, run_accepted: bool, sample: int | None) -> Counter[str]:
    """Judge a file's mutants, print what became of them and keep the score. `right`: all is as it should be."""
    begun_s = time.monotonic()
    source = (ROOT / file).read_text(encoding="utf-8")
    mutants = {str(mutant.name): mutant.source for mutant in (*mutants_of(source), *made_by_hand(file, source))}
    forgiven = accepted(file)
    wrong = [f"accepted, but no mutant any more: {name}" for name in forgiven.keys() - mutants.keys()]
    todo = [name for name in mutants if run_accepted or name not in forgiven]
    if sample is not None:
        todo = sorted(todo, key=lambda name: sha256(name.encode()).digest())[:sample]
    found: Counter[Outcome] = Counter()
    try:
        for number, verdict in verdicts(Subject(ROOT, file, JUDGES[file], tuple(mutants[name] for name in todo))):
            name = todo[number]
            if name not in forgiven:
                found[verdict.outcome] += 1
            if verdict.outcome is Outcome.SURVIVED and name not in forgiven:
                wrong.append(f"survived: {name}")
            elif verdict.outcome in (Outcome.KILLED, Outcome.TIMED_OUT) and name in forgiven:
                wrong.append(f"accepted, but noticed by {verdict.test}: {name}")
    except TestsFailError as error:
        wrong.append(f"its tests fail without a mutant, so they can judge nothing: {error}")
    killed = found[Outcome.KILLED] + found[Outcome.TIMED_OUT]
    score = Counter(
        killed=killed,
        by_time=found[Outcome.TIMED_OUT],
        wanted=killed + found[Outcome.SURVIVED],
        accepted=len(forgiven.keys() & mutants.keys()),
        generated=len(mutants),
    )
    if sample is None:
        keep(file, score)
    share = killed / max(1, score["wanted"])
    took_s = time.monotonic() - begun_s
    print(f"{file}: {killed} of {score['wanted']} ({share:.1%}), {score['accepted']} accepted, {took_s:.0f} s")
    print("".join(f"  {line}\n" for line in wrong), end="", flush=True)
    score["right"] = not wrong
    return score


def keep(file: str, score: Counter[str]) -> None:
    """Write a file's score down: how many are killed (some by time: tests never ended) of how many that ought to be.

    `score` is that in per cent; `digest` and `commit` say of which text. The safety case reads these (tests/case).
    """
    scores = json.loads(SCORES.read_text(encoding="utf-8"))
    share = round(100 * score["killed"] / max(1, score["wanted"]), 1)
    scores[file] = {**score, "score": share, "digest": program.digest(ROOT / file), "commit": commit()}
    SCORES.write_text(json.dumps(scores, indent=2, sort_keys=True) + "\n", encoding="utf-8")


def commit() -> str:
    """The commit that is judged; with a `+` where files differ from it."""
    return subprocess.run(
        ["git", "describe", "--always", "--dirty=+", "--exclude=*"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
