"""`python -m tests.case`: the safety case of these files, as a tree. Exit code 1: a claim is red.

python -m tests.case            # judges what the tests and the benchmark have left in build/case
python -m tests.case --run      # runs first the tests that it names and that are not shown for these files
python -m tests.case --draw     # writes docs/safety-case.svg anew
"""

import argparse
import json
import os
import subprocess
import sys
from collections import Counter

from pydantic import ValidationError

from tests.case import extended, kernel, left
from tests.case.case import ROOT, Case, load
from tests.case.judge import SCORES, Judged, Ran, Verdict, is_shown, judge, worst
from tests.case.picture import draw

DRAWN = ROOT / "docs" / "safety-case.svg"
_SIGNS = {Verdict.SHOWN: ("✓", 32), Verdict.PERSON: ("☐", 33), Verdict.RED: ("✗", 31)}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.case", description="The safety case of these files.")
    parser.add_argument("--run", action="store_true", help="run the tests that it names, unless that was done")
    parser.add_argument("--draw", action="store_true", help="write docs/safety-case.svg anew")
    parser.add_argument("--all", action="store_true", help="show each piece of evidence, also what is shown")
    chosen = parser.parse_args()
    try:
        case = load()
    except (ValidationError, ValueError) as error:
        print(f"safety/case.toml: {error}", file=sys.stderr)
        return 1
    if chosen.draw:
        DRAWN.write_text(draw(case))
        return 0
    if chosen.run:
        _run(sorted(test for test in case.tests() if not is_shown(test, _ran(case))))
    verdicts = {name: judge(claim, _ran(case)) for name, claim in case.claims.items()}
    (left.LEFT / "case.svg").write_text(draw(case, {name: worst(judged) for name, judged in verdicts.items()}))
    print(as_text(case, verdicts, every=chosen.all, colours=sys.stdout.isatty()))
    return 1 if any(worst(judged) is Verdict.RED for judged in verdicts.values()) else 0


def _ran(case: Case) -> Ran:
    scores = json.loads(SCORES.read_text()) if SCORES.exists() else {}
    return Ran(left.outcomes(), left.bench(), scores, kernel.read(), extended.read(), case.judges)


def _run(tests: list[str]) -> None:
    if not tests:
        return
    print(f"running the {len(tests)} tests that the case leans on and that are not shown for these files …")
    if left.outcomes() is None:
        left.begin()
    record = left.LEFT / "case.xml"
    subprocess.run([sys.executable, "-m", "pytest", "-q", f"--junitxml={record}", *tests], cwd=ROOT, check=False)
    extended.leave(extended.commit())


def as_text(case: Case, verdicts: dict[str, list[Judged]], *, every: bool = False, colours: bool = False) -> str:
    """The tree: hazards, their claims, and below each claim, once, what of it is not shown (or everything)."""
    lines = []
    explained: set[str] = set()
    for hazard_name, hazard in case.hazards.items():
        lines += ["", f"{hazard.text} [{hazard_name}]"]
        for name, claim in case.about(hazard_name).items():
            judged = verdicts[name]
            shown = sum(each.verdict is Verdict.SHOWN for each in judged)
            lines.append(f"  {_sign(worst(judged), colours)} {claim.text} [{name}] {shown} of {len(judged)} shown")
            if name in explained:
                continue
            explained.add(name)
            for each in judged:
                if every or each.verdict is not Verdict.SHOWN:
                    why = f": {each.why}" if each.why else ""
                    lines.append(f"      {_sign(each.verdict, colours)} {each.evidence}{why}")
            if every:
                lines += [f"      ? {defeater.text} ({defeater.settled_by})" for defeater in claim.defeaters]
    counted = Counter(worst(judged) for judged in verdicts.values())
    lines += ["", ", ".join(f"{counted[verdict]} {verdict}" for verdict in Verdict) + f" of {len(verdicts)} claims"]
    return "\n".join(lines).lstrip("\n")


def _sign(verdict: Verdict, colours: bool) -> str:
    sign, colour = _SIGNS[verdict]
    return f"\x1b[{colour}m{sign}\x1b[0m" if colours and not os.environ.get("NO_COLOR") else sign


if __name__ == "__main__":
    sys.exit(main())
