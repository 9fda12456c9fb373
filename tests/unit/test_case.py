"""The safety case turns red where its evidence does, and its parts agree with each other."""

from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from pydantic import ValidationError

from gateway.people.tools.drill.steps import STEPS
from tests.case import extended, left, program
from tests.case.__main__ import DRAWN, as_text
from tests.case.case import ROOT, Case, Claim, Figure, Mutants, load
from tests.case.judge import Judged, Ran, Verdict, judge, worst
from tests.case.kernel import Report
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


@pytest.mark.parametrize("result", ["failed", "skipped"])
def test_one_that_failed_or_was_skipped_turns_it_red(result: str) -> None:
    found = verdict(claim(), ran(PASSED, Outcome("test_it_is_whole[b]", result)))
    assert found == Judged(Verdict.RED, THIS, f"test_it_is_whole[b] {result}")


@pytest.mark.parametrize("gone", ["tests/unit/test_case.py::test_renamed", "tests/unit/test_gone.py::test_it_is_whole"])
def test_one_that_is_gone_or_renamed_turns_it_red_although_it_passed_once(gone: str) -> None:
    assert verdict(claim(tests=[gone]), ran(PASSED, test=gone)) == Judged(Verdict.RED, gone, "there is no such test")


SEARCH = "tests/fuzz/test_model_check.py::test_every_reachable_state_keeps_every_promise"
FLOOR: dict[str, Any] = {"tests": [], "mutants": [Mutants(module=BUS, at_least=98)]}
SCENE: dict[str, Any] = {"tests": [], "kernel": [{"scene": "atomic"}]}
FLOOD: dict[str, Any] = {"tests": [], "bench": [{"row": "flood"}]}


def promise(text: str) -> dict[str, object]:
    return {"tests": [], "model": [{"promise": text}]}


def inputs(at_least: float, name: str = "inputs") -> dict[str, object]:
    return {"figures": [Figure(test=THIS, name=name, at_least=at_least)]}


def scored(score: float, digest: str) -> Ran:
    """The bus's mutants were judged when its program had this digest."""
    return Ran({}, None, {BUS: {"score": score, "digest": digest}})


def measured(gateway: str, aim: str, met: bool | None) -> Ran:
    """A run of the benchmark."""
    return Ran({}, [{"name": "flood: p99", "gateway": gateway, "aim": aim, "met": met}], {})


def played(holds: bool, files: str | None = None, scene: str = "atomic") -> Ran:
    """A run of `make kernel`, for these files or others."""
    return Ran({}, None, {}, Report("2026-11-23", "6.1.0-56-amd64", "", files or left.mark(), {scene: holds}))


VERDICTS: dict[str, tuple[dict[str, Any], Ran, Verdict]] = {
    "a test that passed with all its parameters": ({}, ran(PASSED, PASSED), Verdict.SHOWN),
    "a test that failed beside others and passed alone": ({}, ran(PASSED, Outcome("x", "flaky")), Verdict.PERSON),
    "a test that was left out": ({}, ran(), Verdict.RED),
    "no run of these files": ({}, Ran(None, None, {}), Verdict.RED),
    "a section that is gone": ({"section": "docs/safety.md#renamed"}, ran(PASSED), Verdict.RED),
    "a document that is gone": ({"section": "docs/gone.md#the-case"}, ran(PASSED), Verdict.RED),
    "a promise of the model check": (
        promise("in every step, all Stops come before anything else"),
        ran(PASSED, test=SEARCH),
        Verdict.SHOWN,
    ),
    "one about each servo": (
        promise("the Stop for {servo_id} is sent at once"),
        ran(PASSED, test=SEARCH),
        Verdict.SHOWN,
    ),
    "a promise that it does not make": (promise("no Stop is needed"), ran(PASSED, test=SEARCH), Verdict.RED),
    "a score above its floor": (FLOOR, scored(98.5, program.digest(ROOT / BUS)), Verdict.SHOWN),
    "a score of an older text": (FLOOR, scored(98.5, "an older one"), Verdict.PERSON),
    "a score below its floor": (FLOOR, scored(97.9, program.digest(ROOT / BUS)), Verdict.RED),
    "a score that nobody measured": (FLOOR, ran(PASSED), Verdict.RED),
    "a figure that the test left": (inputs(500), ran(PASSED), Verdict.SHOWN),
    "a figure that is too small": (inputs(501), ran(PASSED), Verdict.RED),
    "a figure that the test did not leave": (inputs(0, "other"), ran(PASSED), Verdict.RED),
    "no run of the benchmark": (FLOOD, Ran({}, None, {}), Verdict.PERSON),
    "a benchmark without the row": (FLOOD, Ran({}, [], {}), Verdict.PERSON),
    "a row within its bound": (FLOOD, measured("4 ms", "at most 5 ms", True), Verdict.SHOWN),
    "a row beyond its bound": (FLOOD, measured("6 ms", "at most 5 ms", False), Verdict.RED),
    "a row without a bound": (FLOOD, measured("6 ms", "", None), Verdict.RED),
    "no run of make kernel": (SCENE, Ran({}, None, {}), Verdict.PERSON),
    "a run without the scene": (SCENE, played(True, scene="killed"), Verdict.PERSON),
    "a scene that held": (SCENE, played(True), Verdict.SHOWN),
    "a scene that held for other files": (SCENE, played(True, "other"), Verdict.PERSON),
    "a scene that did not hold": (SCENE, played(False), Verdict.RED),
    "a scene that there is not": ({"tests": [], "kernel": [{"scene": "gone"}]}, played(True), Verdict.RED),
    "a step of the drill": ({"drill": ["estop"]}, ran(PASSED), Verdict.PERSON),
    "a step that the drill has not": ({"drill": ["gone"]}, ran(PASSED), Verdict.RED),
}


@pytest.mark.parametrize("what", VERDICTS)
def test_what_is_there_decides(what: str) -> None:
    parts, what_ran, wanted = VERDICTS[what]
    assert verdict(claim(**parts), what_ran).verdict is wanted


def test_each_test_that_only_test_all_runs_states_what_it_judges() -> None:
    case = load()
    assert set(case.judges) == extended.needed(case)
    assert not [path for judged in case.judges.values() for path in judged if not (ROOT / path).exists()]


SLOW = "tests/fuzz/test_fuzz.py::test_a_short_run_finds_nothing"
"""One that only `make test-all` runs."""


def recorded(files: str, inputs: float = 500) -> Ran:
    """It passed at an earlier commit, when what it judges had this digest."""
    shown = extended.Shown("0123456789", files, 7, {"inputs": inputs})
    return Ran({}, None, {}, extended={SLOW: shown}, judges={SLOW: ["schemas"]})


@pytest.mark.parametrize(
    ("what_ran", "expected"),
    [
        (recorded(extended.digest(SLOW, ["schemas"])), (Verdict.SHOWN, "at 0123456789")),
        (recorded("other"), (Verdict.RED, "it last passed at 0123456789; what it judges has changed since")),
        (Ran({}, None, {}), (Verdict.RED, "only make test-all runs it, and nobody has")),
        (ran(Outcome("a", "failed"), test=SLOW), (Verdict.RED, "a failed")),
    ],
    ids=["unchanged", "changed since", "never run", "failed in this run"],
)
def test_what_test_all_showed_counts_until_what_it_judges_changes(what_ran: Ran, expected: tuple[Verdict, str]) -> None:
    (found,) = (each for each in judge(claim(tests=[SLOW]), what_ran) if each.evidence == SLOW)
    assert (found.verdict, found.why.partition(": make")[0]) == expected


def test_a_figure_of_that_run_counts_as_well() -> None:
    figure = Figure(test=SLOW, name="inputs", at_least=500)
    files = extended.digest(SLOW, ["schemas"])
    assert verdict(claim(tests=[], figures=[figure]), recorded(files, 500)).verdict is Verdict.SHOWN
    assert verdict(claim(tests=[], figures=[figure]), recorded(files, 499)).verdict is Verdict.RED


def test_the_record_has_what_passed_and_keeps_the_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A failed one keeps the record of when it last passed; a record of other files then says so."""
    case = Case.model_validate(
        {
            "hazards": {"h": {"text": "it falls"}},
            "claims": {"a": claim(tests=[SLOW, THIS]).model_dump()},
            "judges": {SLOW: ["schemas"]},
        }
    )
    monkeypatch.setattr(extended, "load", lambda: case)
    passed = {
        SLOW: [Outcome("x[1]", "passed", {"inputs": "3"}), Outcome("x[2]", "passed", {"inputs": "2"})],
        THIS: [PASSED],
    }
    record = tmp_path / "test-all.json"
    monkeypatch.setattr(left, "outcomes", lambda: passed)
    extended.leave("0123456789", record)
    shown = extended.read(record)
    assert set(shown) == {SLOW}
    assert (shown[SLOW].times, shown[SLOW].figures) == (2, {"inputs": 2.0})
    assert shown[SLOW].files == extended.digest(SLOW, ["schemas"])
    monkeypatch.setattr(left, "outcomes", lambda: {SLOW: [Outcome("x[1]", "failed")]})
    extended.leave("0123456789", record)
    assert extended.read(record) == shown


def test_a_digest_changes_with_the_test_and_with_each_file_that_it_judges(tmp_path: Path) -> None:
    (tmp_path / "tests").mkdir()
    for name in ("tests/test_x.py", "a.py", "b.py"):
        (tmp_path / name).write_text("1")
    found = [extended.digest("tests/test_x.py::test_y", ["a.py"], tmp_path)]
    for name in ("b.py", "a.py", "tests/test_x.py"):
        (tmp_path / name).write_text("2")
        found.append(extended.digest("tests/test_x.py::test_y", ["a.py"], tmp_path))
    assert found[0] == found[1]
    assert len(set(found)) == 3


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


def test_one_that_passed_alone_is_flaky_and_one_that_failed_again_has_failed(tmp_path: Path) -> None:
    root, folder = files(tmp_path / "tree"), tmp_path / "left"
    left.begin(folder, root)
    record(folder / "together.xml", ("test_a", "failure"), ("test_b", "failure"), ("test_c", ""))
    record(folder / "again.xml", ("test_a", ""), ("test_b", "failure"))
    found = left.outcomes(folder, root) or {}
    assert [each.result for outcomes in found.values() for each in outcomes] == ["flaky", "failed", "passed"]
    assert [each.result for _, each in left.cases(folder)] == ["failed", "failed", "passed"]


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
