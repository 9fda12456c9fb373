"""The failed tests of a run of several stages, a line each: its last lines name them, whatever ended the run."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import pytest

LIST: Final = "TESTS_FAILED"
"""The environment variable that names the list, for the stages."""
_WIDTH, _MOST = 200, 20


@contextmanager
def listed() -> Iterator[None]:
    """Collect what fails in the stages that begin within, and print it at the end."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "failed"
        path.touch()
        os.environ[LIST] = str(path)
        try:
            yield
        finally:
            for line in path.read_text(encoding="utf-8").splitlines()[:_MOST]:
                print(line)


def add(report: pytest.TestReport) -> None:
    """Add a failed test to the run's list, if there is one; a worker's reports come to its controller, too."""
    path = os.environ.get(LIST)
    if report.failed and path and "PYTEST_XDIST_WORKER" not in os.environ:
        crash = getattr(report.longrepr, "reprcrash", None)
        why = (crash.message if crash else str(report.longrepr)).strip().partition("\n")[0]
        with Path(path).open("a", encoding="utf-8") as lines:
            lines.write(f"failed in {report.when}: {report.nodeid}: {why}"[:_WIDTH] + "\n")
