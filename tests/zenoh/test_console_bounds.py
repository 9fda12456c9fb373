"""Fifty pages, one of them frozen, one flooding: memory is bounded, and nobody waits for these two.

How long is measured by `python -m tests.benchmarks.console`; here the bounds are wide, for machines that are busy.
"""

from pathlib import Path
from typing import Final

import pytest

from tests.benchmarks.console import measure, p99

pytestmark = [pytest.mark.full, pytest.mark.alone]

MOST_MS: Final = 3000
"""Of which a busy machine has the half."""


def test_fifty_pages(tmp_path: Path) -> None:
    figures = measure(tmp_path, seconds=5.0)
    print(figures)
    assert figures.floods_ended > 2
    assert p99(figures.state_age_ms) < MOST_MS
    assert p99(figures.stop_ms) < MOST_MS
    assert figures.after_mb - figures.before_mb < 40
