"""The mutants are those that are meant, and the runner tells what a test notices from what none does.

A sample of them is judged here, so that nothing of it rots between two runs of `make mutants`.
"""

import os
import re
import select
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Final

import pytest

from tests.mutants.__main__ import ROOT, below_floor
from tests.mutants.by_hand import MADE, made_by_hand
from tests.mutants.generated import Accepted, accepted, mutants_of, short
from tests.mutants.judges import JUDGES
from tests.mutants.judging import Outcome, Subject, verdicts
from tests.mutants.operators import operators
from tests.support.runs import children
from tests.support.waiting import wait_until

SAMPLED: Final = ("spi/guard", "core/body_limits")
"""Files whose tests are quick, and notice each mutant of them that is not accepted."""


def test_a_sample_is_noticed() -> None:
    command = [sys.executable, "-m", "tests.mutants", "--sample", "8", *SAMPLED]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    killed, wanted = map(int, re.findall(r"^(\d+) of (\d+) killed", done.stdout, re.MULTILINE)[0])
    assert killed == wanted >= 12


def test_every_file_that_is_named_is_there() -> None:
    comments = {path: accepted(path.read_text(encoding="utf-8")) for path in (ROOT / "gateway").rglob("*.py")}
    commented = {str(path.relative_to(ROOT)) for path, found in comments.items() if found}
    assert {*MADE, *commented} <= JUDGES.keys()
    named = {operator for found in comments.values() for comment in found for operator in comment.operators}
    assert named <= {short(operator) for operator in operators()}
    for each in {*JUDGES, *(test for tests in JUDGES.values() for test in tests)}:
        file, _, test = each.partition("::")
        assert re.search(rf"def {test}|^{test} = ", (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE), each


@pytest.mark.parametrize("file", MADE)
def test_what_was_made_by_hand_fits_the_code_as_it_is(file: str) -> None:
    for mutant in made_by_hand(file, (ROOT / file).read_text(encoding="utf-8")):
        compile(mutant.source, file, "exec")


def test_a_comment_accepts_mutants_of_its_line_or_of_all_that_begins_there() -> None:
    source = (
        "a = (\n    1)\n# mutants accepted (Step, Forget): a reason\nb = (\n    2)\n"
        "c = 3  # mutants accepted (Scale): another\n"
        "@cache\ndef f():  # mutants accepted (Lt_LtE): equal times\n    d = 4\n    return d\n"
    )
    step, scale, less = frozenset({"Step", "Forget"}), frozenset({"Scale"}), frozenset({"Lt_LtE"})
    assert accepted(source) == [Accepted(4, 5, step), Accepted(6, 6, scale), Accepted(7, 10, less)]


def test_a_decorator_that_is_left_out_is_of_its_function() -> None:
    source = "a = 1\n\n\n# mutants accepted (RemoveDecorator): time\n@cache\ndef f():\n    return 2\n"
    (left_out,) = [mutant for mutant in mutants_of(source) if mutant.operator == "RemoveDecorator"]
    assert [comment.takes(left_out) for comment in accepted(source)] == [True]


def test_a_room_below_the_floor_is_named() -> None:
    full, low = Counter(killed=97, wanted=100), Counter(killed=96, wanted=100)
    scores = {
        "gateway/robot/core/legs.py": full,
        "gateway/model/frames.py": low,
        "gateway/rate_limit.py": Counter(wanted=9),
    }
    assert dict(below_floor(scores)) == {"gateway/model": 0.96}


SMALL = '''
LIMIT = 1000
KNOWN = {"a", "b"}


def act(self, x):
    """What it does."""
    if not x:
        return
    self.seen = x
    kept = call(x, again=True)
    try:
        self.go(
            x,
        )
    except (zenoh.ZError, OSError):
        raise
    match x:
        case int() if x > 3:
            del kept


MADE = """
  open: { enabled: false },
"""
'''


def test_a_statement_is_forgotten_once_each() -> None:
    forgotten = [mutant.was for mutant in mutants_of(SMALL) if mutant.operator == "Forget"]
    assert forgotten == ["return", "self.seen = x", "self.go(x, )", "raise", "del kept"]


FILES = {
    "gateway/__init__.py": "",
    "gateway/sums.py": (
        "LEAST = max(1, 2)\n\n\ndef add(a, b):\n    return a + b\n\n\ndef name():\n    return 'sum'\n\n\n"
        "def early():\n    return 3\n\n\nEARLY = early()\n"
    ),
    "tests/__init__.py": "",
    "tests/test_sums.py": (
        "from gateway import sums\n\n\ndef test_add():\n    assert sums.add(2, 3) == 5\n\n\n"
        "def test_early():\n    assert (sums.LEAST, sums.EARLY) == (2, 3)\n"
    ),
}
OUTCOMES = [
    ("a + b", "a - b", Outcome.KILLED),
    ("'sum'", "'product'", Outcome.SURVIVED),
    ("    return a + b", "    while True: pass", Outcome.TIMED_OUT),
    ("a + b", "__import__('os').abort()", Outcome.KILLED),
    ("max(1, 2)", "max(1, 1)", Outcome.KILLED),
    ("def add", "raise OSError\ndef add", Outcome.INCOMPETENT),
    ("return 3", "return 4", Outcome.KILLED),
    ("return a + b", "return b + a", Outcome.SURVIVED),
]


def judge_a_small_tree(root: Path) -> None:
    """Print the fate of each mutant. It forks, so it runs in a process without threads."""
    for name, text in FILES.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    mutated = tuple(FILES["gateway/sums.py"].replace(old, new) for old, new, _ in OUTCOMES)
    found = verdicts(Subject(root, "gateway/sums.py", ("tests/test_sums.py",), mutated))
    print([(verdict.outcome.name, verdict.test) for verdict in found])


def test_what_became_of_each(tmp_path: Path) -> None:
    script = f"from pathlib import Path; import {__name__} as m; m.judge_a_small_tree(Path({str(tmp_path)!r}))"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False)
    tests = ["add", "", "", "", "early", "", "early", ""]
    assert done.stdout.strip() == str(
        [
            (outcome.name, f"tests/test_sums.py::test_{test}" if test else "")
            for (_, _, outcome), test in zip(OUTCOMES, tests, strict=True)
        ]
    ), done.stderr
    assert (tmp_path / "gateway/sums.py").read_text() == FILES["gateway/sums.py"], "no file is ever changed"


def test_a_process_that_judges_ends_with_the_one_that_started_it(tmp_path: Path) -> None:
    (tmp_path / "test_forever.py").write_text("while True:\n    pass\n")
    subject = f"Subject(Path({str(tmp_path)!r}), 'gateway/sums.py', ('test_forever.py',), ())"
    script = f"from pathlib import Path; from tests.mutants.judging import *; next(verdicts({subject}))"
    with subprocess.Popen([sys.executable, "-c", script], cwd=ROOT) as runner:
        wait_until(lambda: bool(children(runner.pid)))
        ended = os.pidfd_open(*children(runner.pid))
        runner.terminate()
    assert select.select([ended], [], [], 30)[0], "it goes on judging"
    os.close(ended)
