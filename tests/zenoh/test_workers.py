"""Runs of the tests: workers, programs where an extra is missing, what ends with its run, and which tests run when."""

import os
import select
import sys
from pathlib import Path

import pytest

from tests.box.box import lacks_tools
from tests.support import schedule
from tests.support.child import Child
from tests.support.command import run_program
from tests.support.runs import ENDS_WITH_US, children
from tests.support.schedule import TESTS

pytest_plugins = ("pytester",)


def test_workers_that_end_are_replaced_and_the_tests_that_ended_them_do_not_run_again(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two at once, which a machine that stood still does to the tests that it held up."""
    pytester.makeconftest("""
        from tests.support import runs
        from tests.support.workers import pytest_xdist_make_scheduler
        def pytest_runtest_logreport(report):
            runs.add(report)
    """)
    ends = "import os, pytest\n@pytest.mark.parametrize('n', range(9))\ndef test_it(n):\n    n == 4 and os._exit(1)\n"
    pytester.makepyfile(test_one=ends, test_other=ends, test_third="def test_it():\n    pass")
    listed = pytester.path / "listed"
    monkeypatch.setenv("TESTS_FAILED", str(listed))
    monkeypatch.setenv("PYTHONPATH", str(TESTS.parent))
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    result = pytester.runpytest_subprocess("-n", "2", "-p", "no:cacheprovider")
    assert result.parseoutcomes() == {"passed": 17, "failed": 2}
    assert sorted(line.split(": ")[1] for line in listed.read_text().splitlines()) == [
        "test_one.py::test_it[4]",
        "test_other.py::test_it[4]",
    ]


def test_programs_are_forked_although_a_module_cannot_be_imported(tmp_path: Path) -> None:
    """An extra is missing, and its module may end with what to type. MuJoCo starts a program while it is imported."""
    for module, error in {"foxglove": "ImportError", "mujoco": "BlockingIOError"}.items():
        (tmp_path / f"{module}.py").write_text(f"raise {error}")
    imported = "from tests.support import zygote; zygote._imported()"
    done = run_program(sys.executable, "-c", imported, cwd=TESTS.parent, env={"PYTHONPATH": str(tmp_path)})
    assert done.stderr == ""


def test_scenes_need_no_tools_of_tests() -> None:
    """A robot on which they are played has the package, and no pytest."""
    found = "import sys, tests.kernel.inside.scenes; print({'pytest', 'hypothesis'} & {*sys.modules})"
    assert run_program(sys.executable, "-c", found, cwd=TESTS.parent).stdout == "set()\n"


@pytest.mark.full
def test_what_is_to_end_with_its_run_does_if_the_run_is_killed() -> None:
    schedule.skip_where(lacks_tools("what ends with its run is", "setpriv", "unshare"))
    command = [*ENDS_WITH_US, "sh", "-c", "sleep 1000 & echo sleeps; wait"]
    with Child([sys.executable, "-c", f"import subprocess; subprocess.run({command})"], os.environ) as run:
        run.wait_for_output("sleeps")
        (namespace,) = children(run.pid)
        (first,) = children(namespace)
        ends = [os.pidfd_open(each) for each in (first, *children(first))]
        assert len(ends) == 2
        run.kill()
        for each in ends:
            assert select.select([each], [], [], 30)[0]
            os.close(each)


# ---- which tests run when


TEST, ALL = "not full and not nightly", "not alone and not attended and not searches and not nightly"


def test_what_is_named_is_there() -> None:
    for place in (*schedule.FOLDERS, *schedule.APART, *schedule.TOGETHER, *schedule.SECOND_BOX):
        assert (TESTS / place).exists(), place


@pytest.mark.parametrize(
    ("file", "text", "marks", "elsewhere"),
    [
        ("zenoh/test_a.py", "", TEST, False),
        ("zenoh/test_a.py", "@pytest.mark.full\ndef test_a(): ...", TEST, False),
        ("zenoh/test_a.py", "pytestmark = pytest.mark.full", TEST, True),
        ("zenoh/test_a.py", "pytestmark = pytest.mark.full", ALL, False),
        ("zenoh/test_a.py", "pytestmark = [\n    pytest.mark.hil,\n    pytest.mark.nightly,\n]", ALL, True),
        ("zenoh/test_a.py", "pytestmark = pytest.mark.hil\n\n@pytest.mark.nightly\ndef test_a(): ...", ALL, False),
        ("hil/test_a.py", "", TEST, True),
        ("walking/test_a.py", "", ALL, True),
        ("zenoh/test_a.py", "", "alone and not nightly", True),
        ("zenoh/test_a.py", "@pytest.mark.alone\ndef test_a(): ...", "alone and not nightly", False),
        ("net/data.json", "", "attended", False),
    ],
)
def test_a_file_is_imported_only_where_it_has_tests_that_run(
    file: str, text: str, marks: str, elsewhere: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(schedule, "TESTS", tmp_path)
    (tmp_path / file).parent.mkdir()
    (tmp_path / file).write_text(text)
    assert schedule.is_elsewhere(tmp_path / file, marks) is elsewhere


@pytest.mark.parametrize(
    ("marks", "tiers"),
    [([], set()), (["nightly"], {"nightly"}), (["hil", "nightly"], {"nightly"})]
    + [([name], {"full"}) for name in schedule.LACKS],
)
def test_what_needs_root_or_packages_is_never_in_make_test(
    request: pytest.FixtureRequest, marks: list[str], tiers: set[str]
) -> None:
    """Also a single test, in a folder of which all others need nothing."""
    item = pytest.Function.from_parent(request.node.parent, name="test_one", callobj=lambda: None)
    for mark in marks:
        item.add_marker(mark)
    schedule.arrange([item])
    assert {mark.name for mark in item.iter_markers()} & {*schedule.TIERS} == tiers


def test_what_is_apart_shares_nothing() -> None:
    """A fixture for a whole file would be made anew on each worker, and for a whole folder, too."""
    for place in schedule.APART:
        path = TESTS / place
        for file in path.glob("*.py") if path.is_dir() else [path]:
            assert 'scope="' not in file.read_text(), file
