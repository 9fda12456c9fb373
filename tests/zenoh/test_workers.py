"""The workers of a run of tests, some of which end."""

import pytest

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
