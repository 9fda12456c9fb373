"""`python -m tests.mutants [PART OF A FILE'S NAME …]`: does a test fail for each mutant?

Prints what survives and a score for each file. Ends with 1 where a room of FLOORED is below FLOOR, or a file's tests
fail without a mutant.
"""

import argparse
import math
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Final

from tests.mutants.by_hand import made_by_hand
from tests.mutants.generated import Accepted, Mutant, accepted, mutants_of
from tests.mutants.judges import JUDGES
from tests.mutants.judging import Outcome, Subject, TestsFailError, verdicts
from tests.support import runs

ROOT: Final = Path(__file__).parents[2]
FLOOR: Final = 0.97
"""The share of a room's mutants that some test has to notice, without those that a comment accepts."""
FLOORED: Final = ("gateway/model", "gateway/robot/core", "gateway/robot/spi", "gateway/robot/power")
"""The rooms that keep the robot safe."""


def main() -> int:
    """Judge all mutants, or those of the files that are named in part. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="make mutants", description="Does a test fail for each mutant?")
    parser.add_argument("names", nargs="*", help="only files whose name has one of these in it")
    parser.add_argument(
        "--changed", action="store_true", help="only files that the last commit or nobody yet has changed"
    )
    parser.add_argument("--sample", type=int, metavar="N", help="of each file only these many, always the same ones")
    parser.add_argument("--seconds", type=float, default=math.inf, help="begin with no further file after so many")
    arguments = parser.parse_args()
    os.environ.pop(runs.LIST, None)  # a test that fails here is one that notices
    until_s = time.monotonic() + arguments.seconds
    files = [file for file in JUDGES if not arguments.names or any(name in file for name in arguments.names)]
    if arguments.changed:
        files = [file for file in files if file in changed()]
    # Not a list that ends early: a survivor in one file hides none in the next.
    scores = []
    for number, file in enumerate(files):
        if time.monotonic() > until_s:
            print("not judged, for want of time: " + ", ".join(files[number:]))
            del files[number:]
            break
        scores.append(judge(file, arguments.sample))
    killed, wanted = (sum(score[of] for score in scores) for of in ("killed", "wanted"))
    print(f"\n{killed} of {wanted} killed ({killed / max(1, wanted):.1%}) in {len(files)} files")
    low = list(below_floor(dict(zip(files, scores, strict=True))))
    print("".join(f"below {FLOOR:.0%}: {room}: {share:.1%}\n" for room, share in low), end="")
    return 0 if not low and all(score["right"] for score in scores) else 1


def below_floor(scores: Mapping[str, Counter[str]]) -> Iterator[tuple[str, float]]:
    """Yield the rooms of FLOORED of which too little is noticed, with the share that is."""
    for room in FLOORED:
        of_room = [score for file, score in scores.items() if file.startswith(f"{room}/")]
        killed, wanted = (sum(score[of] for score in of_room) for of in ("killed", "wanted"))
        if killed < FLOOR * wanted:
            yield room, killed / wanted


def judge(file: str, sample: int | None) -> Counter[str]:
    """Judge a file's mutants, and print what became of them. Returns the score. `right`: its tests pass without one."""
    begun_s = time.monotonic()
    source = (ROOT / file).read_text(encoding="utf-8")
    todo = sorted((*mutants_of(source), *made_by_hand(file, source)), key=_by_its_text)[:sample]
    found: Counter[Outcome] = Counter()
    survivors: list[Mutant] = []
    try:
        judged = verdicts(Subject(ROOT, file, JUDGES[file], tuple(mutant.source for mutant in todo)))
        for mutant, verdict in zip(todo, judged, strict=True):
            found[verdict.outcome] += 1
            if verdict.outcome is Outcome.SURVIVED:
                survivors.append(mutant)
    except TestsFailError as error:
        print(f"{file}: its tests fail without a mutant, so they can judge nothing: {error}", flush=True)
        return Counter(right=False)
    comments = accepted(source)
    bad = [mutant for mutant in survivors if not any(comment.takes(mutant) for comment in comments)]
    wrong = [f"survived: {mutant}" for mutant in bad]
    killed = found[Outcome.KILLED] + found[Outcome.TIMED_OUT]
    score = Counter(killed=killed, wanted=killed + len(bad), accepted=len(survivors) - len(bad))
    if sample is None:
        wrong += [f"accepts what no mutant needs: {unused}" for unused in sorted(_unused(comments, survivors))]
    share = killed / max(1, score["wanted"])
    took_s = time.monotonic() - begun_s
    print(f"{file}: {killed} of {score['wanted']} ({share:.1%}), {score['accepted']} accepted, {took_s:.0f} s")
    print("".join(f"  {line}\n" for line in wrong), end="", flush=True)
    score["right"] = True
    return score


def _by_its_text(mutant: Mutant) -> bytes:
    """Order mutants by their text, so that a sample stays the same while the text does, wherever it stands."""
    return sha256(f"{mutant.operator} {mutant.was} {mutant.becomes}".encode()).digest()


def _unused(comments: Iterable[Accepted], survivors: Iterable[Mutant]) -> Iterator[str]:
    """Yield the operators of comments, with their lines, whose mutants are all noticed by now."""
    used = {(comment, each.operator) for comment in comments for each in survivors if comment.takes(each)}
    for comment in comments:
        yield from (f"{comment.first}: {name}" for name in comment.operators if (comment, name) not in used)


def changed() -> set[str]:
    """Return the files that differ from the commit before the last one, or none in a clone without it."""
    command = ["git", "diff", "--name-only", "HEAD~1"]
    return {*subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout.splitlines()}


if __name__ == "__main__":
    sys.exit(main())
