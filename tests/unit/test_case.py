"""The safety case turns red where its evidence does, and its parts agree with each other."""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from xml.etree import ElementTree

import pytest
from pydantic import ValidationError

from gateway.people.tools.drill.steps import STEPS
from tests.case import left
from tests.case.__main__ import DRAWN, as_text
from tests.case.case import ROOT, Case, Claim, Figure, Mutants, load
from tests.case.judge import Judged, Ran, Verdict, judge, worst
from tests.case.left import Outcome
from tests.case.picture import draw

THIS = "tests/unit/test_case.py::test_it_is_whole"
BUS = "gateway/robot/spi/bus.py"


def claim(**parts: object) -> Claim:
    """About nothing in particular, shown by a test of this file."""
    given = {"hazards": ["h"], "text": "t", "section": "docs/safety.md#the-case", "tests": [THIS]}
    return Claim.model_validate(given | parts)


def ran(*outcomes: Outcome, test: str = THIS) -> Ran:
    return Ran({test: outcomes} if outcomes else {}, None, {})


PASSED = Outcome("test_it_is_whole[a]", "passed", {"inputs": "500"})


def verdict(of: Claim, what_ran: Ran) -> Judged:
    """The worst, with its reason."""
    return max(judge(of, what_ran), key=lambda each: each.verdict.worse)


def test_it_is_whole() -> None:
    """Each hazard has a claim, each claim evidence and a section; what it leans on exists."""
    case = load()
    gone = [
        each
        for found in case.claims.values()
        for each in judge(found, Ran(None, None, {}))
        if each.why.startswith(
            ("there is no such", "the document has no", "the model check makes no", "the drill has no")
        )
    ]
    assert not gone


def test_a_test_that_passed_with_all_its_parameters_shows_it() -> None:
    assert verdict(claim(), ran(PASSED, PASSED)).verdict is Verdict.SHOWN


@pytest.mark.parametrize("result", ["failed", "skipped"])
def test_one_that_failed_or_was_skipped_turns_it_red(result: str) -> None:
    found = verdict(claim(), ran(PASSED, Outcome("test_it_is_whole[b]", result)))
    assert found == Judged(Verdict.RED, THIS, f"test_it_is_whole[b] {result}")


def test_one_that_was_left_out_turns_it_red() -> None:
    assert verdict(claim(), ran()).verdict is Verdict.RED


@pytest.mark.parametrize("gone", ["tests/unit/test_case.py::test_renamed", "tests/unit/test_gone.py::test_it_is_whole"])
def test_one_that_is_gone_or_renamed_turns_it_red_although_it_passed_once(gone: str) -> None:
    assert verdict(claim(tests=[gone]), ran(PASSED, test=gone)) == Judged(Verdict.RED, gone, "there is no such test")


def test_without_a_run_of_these_files_it_is_red() -> None:
    assert verdict(claim(), Ran(None, None, {})).verdict is Verdict.RED


@pytest.mark.parametrize("section", ["docs/safety.md#renamed", "docs/gone.md#the-case"])
def test_a_section_that_is_gone_turns_it_red(section: str) -> None:
    assert verdict(claim(section=section), ran(PASSED)).verdict is Verdict.RED


@pytest.mark.parametrize(
    ("promise", "wanted"),
    [
        ("in every step, all Stops come before anything else", Verdict.SHOWN),
        ("the Stop for {servo_id} is sent at once", Verdict.SHOWN),
        ("no Stop is needed", Verdict.RED),
    ],
)
def test_a_promise_is_one_of_the_model_check_s(promise: str, wanted: Verdict) -> None:
    search = "tests/fuzz/test_model_check.py::test_every_reachable_state_keeps_every_promise"
    of = claim(tests=[], model=[{"promise": promise}])
    assert verdict(of, ran(PASSED, test=search)).verdict is wanted


@pytest.mark.parametrize(
    ("score", "text", "wanted"),
    [
        (98.5, (ROOT / BUS).read_bytes(), Verdict.SHOWN),
        (98.5, b"an older one", Verdict.PERSON),
        (97.9, (ROOT / BUS).read_bytes(), Verdict.RED),
    ],
)
def test_a_score_has_a_floor_and_is_of_this_text(score: float, text: bytes, wanted: Verdict) -> None:
    scores = {BUS: {"score": score, "digest": sha256(text).hexdigest()[:16]}}
    of = claim(tests=[], mutants=[Mutants(module=BUS, at_least=98)])
    assert verdict(of, Ran({}, None, scores)).verdict is wanted


def test_a_score_that_nobody_measured_is_red() -> None:
    of = claim(tests=[], mutants=[Mutants(module=BUS, at_least=98)])
    assert verdict(of, ran(PASSED)).verdict is Verdict.RED


@pytest.mark.parametrize(
    ("name", "at_least", "wanted"),
    [
        ("inputs", 500, Verdict.SHOWN),
        ("inputs", 501, Verdict.RED),
        ("other", 0, Verdict.RED),
    ],
)
def test_a_figure_is_what_the_test_left(name: str, at_least: float, wanted: Verdict) -> None:
    of = claim(figures=[Figure(test=THIS, name=name, at_least=at_least)])
    assert verdict(of, ran(PASSED)).verdict is wanted


@pytest.mark.parametrize(
    ("rows", "wanted"),
    [
        (None, Verdict.PERSON),
        ([], Verdict.PERSON),
        ([{"name": "flood: p99", "gateway": "4 ms", "aim": "at most 5 ms", "met": True}], Verdict.SHOWN),
        ([{"name": "flood: p99", "gateway": "6 ms", "aim": "at most 5 ms", "met": False}], Verdict.RED),
        ([{"name": "flood: p99", "gateway": "6 ms", "aim": "", "met": None}], Verdict.RED),
    ],
)
def test_a_row_of_the_benchmark_has_its_bound(rows: list[dict[str, object]] | None, wanted: Verdict) -> None:
    of = claim(tests=[], bench=[{"row": "flood"}])
    assert verdict(of, Ran({}, rows, {})).verdict is wanted


def test_a_step_of_the_drill_is_a_persons() -> None:
    assert verdict(claim(drill=["estop"]), ran(PASSED)).verdict is Verdict.PERSON
    assert verdict(claim(drill=["gone"]), ran(PASSED)).verdict is Verdict.RED


def test_the_drill_names_the_claims_that_name_its_steps() -> None:
    of_the_drill = {(step.name, step.shows) for step in STEPS}
    of_the_case = {(step, name) for name, found in load().claims.items() for step in found.drill}
    assert of_the_drill == of_the_case


@pytest.mark.parametrize(
    "change",
    [
        lambda case: case["claims"]["a"].update(tests=[]),
        lambda case: case["claims"]["a"].update(hazards=["unknown"]),
        lambda case: case["claims"].pop("a"),
        lambda case: case["claims"]["a"].update(test=[THIS]),
    ],
)
def test_a_case_that_is_not_whole_is_none(change: Callable[[dict[str, dict[str, dict[str, object]]]], None]) -> None:
    given = {"hazards": {"h": {"text": "it falls"}}, "claims": {"a": claim().model_dump()}}
    assert Case.model_validate(given)
    change(given)
    with pytest.raises(ValidationError):
        Case.model_validate(given)


# ---- what a run leaves


def files(root: Path) -> Path:
    """A tree that has something of what is judged."""
    (root / "gateway").mkdir(parents=True)
    (root / "gateway" / "stop.py").write_text("STOP = 1\n")
    return root


def record(path: Path, *cases: tuple[str, str]) -> None:
    suite = ElementTree.Element("testsuite")
    for name, inside in cases:
        case = ElementTree.SubElement(suite, "testcase", classname="tests.unit.test_x", name=name)
        if inside:
            ElementTree.SubElement(case, inside)
    ElementTree.ElementTree(suite).write(path)


def test_what_ran_counts_for_the_files_that_it_ran_on(tmp_path: Path) -> None:
    root, folder = files(tmp_path / "tree"), tmp_path / "left"
    assert left.outcomes(folder, root) is None
    left.begin(folder, root)
    record(
        folder / "alone.xml", ("test_a[1]", ""), ("test_a[2]", "failure"), ("test_b", "skipped"), ("test_c", "error")
    )
    found = left.outcomes(folder, root)
    assert found is not None
    assert {name: [each.result for each in outcomes] for name, outcomes in found.items()} == {
        "tests/unit/test_x.py::test_a": ["passed", "failed"],
        "tests/unit/test_x.py::test_b": ["skipped"],
        "tests/unit/test_x.py::test_c": ["failed"],
    }
    (root / "gateway" / "stop.py").write_text("STOP = 0\n")
    assert left.outcomes(folder, root) is None
    left.begin(folder, root)
    assert left.outcomes(folder, root) == {}


def test_the_benchmarks_rows_are_kept_for_these_files_part_by_part(tmp_path: Path) -> None:
    root, folder = files(tmp_path / "tree"), tmp_path / "left"
    left.leave_bench([{"name": "idle", "met": True}], folder, root)
    left.leave_bench([{"name": "flood", "met": False}], folder, root)
    assert left.bench(folder, root) == [{"name": "idle", "met": True}, {"name": "flood", "met": False}]
    (root / "gateway" / "stop.py").write_text("STOP = 0\n")
    assert left.bench(folder, root) is None


# ---- what people see


def test_the_tree_explains_what_is_not_shown_and_each_claim_once() -> None:
    shown, red = claim(), claim(text="another", hazards=["h", "i"], tests=["tests/unit/test_case.py::test_renamed"])
    case = Case.model_validate(
        {
            "hazards": {"h": {"text": "it falls"}, "i": {"text": "it burns"}},
            "claims": {"a": shown.model_dump(), "b": red.model_dump()},
        }
    )
    found = as_text(case, {name: judge(each, ran(PASSED)) for name, each in case.claims.items()})
    assert (
        found
        == """it falls [h]
  ✓ t [a] 2 of 2 shown
  ✗ another [b] 1 of 2 shown
      ✗ tests/unit/test_case.py::test_renamed: there is no such test

it burns [i]
  ✗ another [b] 1 of 2 shown

1 shown, 0 a person must, 1 red of 2 claims"""
    )
    assert worst(judge(red, ran(PASSED))) is Verdict.RED


def test_the_picture_is_that_of_the_case() -> None:
    assert DRAWN.read_text() == draw(load()), "python -m tests.case --draw"


def test_the_page_is_short_and_has_each_hazard() -> None:
    page = (ROOT / "docs" / "safety.md").read_text()
    assert len(page.splitlines()) <= 250
    rows = [
        line for line in page.partition("## Hazards")[2].partition("\n## ")[0].splitlines() if line.startswith("| ")
    ]
    assert len(rows) - 1 == len(load().hazards)
