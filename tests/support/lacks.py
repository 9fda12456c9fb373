"""What this machine lacks for a test, in one line: packages, or the rights of root."""

import importlib
import os
from functools import cache
from typing import Final

import pytest

LACKS: Final = {
    "hil": "tests.hil.bed:missing_packages",
    "net": "tests.net.hosts:lacks",
    "systemd": "tests.box.box:lacks",
    "browser": "tests.console.browser:lacks",
    "other_browsers": "tests.console.other_browsers:lacks",
}
"""By a test's mark: the function that knows; imported where such a test runs, since most runs have none of them."""


def skip_where_lacking(item: pytest.Item) -> None:
    """Skip a test that needs what is not here."""
    skip_where("; ".join(filter(None, (_lack(mark.name) for mark in item.iter_markers()))))


@cache
def _lack(mark: str) -> str:
    module, _, function = LACKS.get(mark, "").partition(":")
    return str(getattr(importlib.import_module(module), function)()) if module else ""


def skip_where(lack: str) -> None:
    """Skip the test where something is lacking, in this one line; but never in CI, where the test fails."""
    if lack and os.environ.get("CI") == "true":
        pytest.fail(lack, pytrace=False)
    if lack:
        pytest.skip(lack)
