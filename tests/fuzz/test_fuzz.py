"""A short run of each fuzzer on every change (`FUZZ_TIMES=100`: as many times as long)."""

import importlib.util
import os
import random
from pathlib import Path

import pytest

from tests.fuzz.run import MAX_GROWTH_MB, fuzz
from tests.fuzz.targets import TARGETS

TIMES = int(os.environ.get("FUZZ_TIMES", "1"))
RUNS = {"intake": TIMES * 50_000, "decode": TIMES * 60_000, "simulator": TIMES * 12_000}
"""Two to four seconds each."""


@pytest.fixture
def _atheris() -> None:
    """Where it cannot be installed, the short runs are left out; but never in CI, where they are wanted."""
    if importlib.util.find_spec("atheris") is None and os.environ.get("CI") != "true":
        pytest.skip("atheris is not installed (pip install -e '.[fuzz]')")


@pytest.mark.usefixtures("_atheris")
@pytest.mark.parametrize("target", TARGETS)
def test_a_short_run_finds_nothing(target: str, tmp_path: Path) -> None:
    report = fuzz(target, RUNS[target], tmp_path, random.SystemRandom().randrange(1, 2**31))
    assert not report.finding, report.finding
    assert report.inputs >= RUNS[target]
    assert report.growth_mb <= MAX_GROWTH_MB
    assert report.edges > 50, "the code under test is instrumented"
    assert sum(report.came_of.values()) >= RUNS[target] * 0.9
    assert WANTED[target] <= report.came_of.keys(), "it gets past the first check"


WANTED = {
    "intake": {"intent", "invalid", "malformed", "too_large", "bad_encoding"},
    "decode": {"bytes: frame", "bytes: no frame", "typed: exit code 0", "typed: exit code 1"},
    "simulator": {"plain: some frames executed", "length-prefixed: some frames executed"},
}
