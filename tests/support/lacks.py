"""What this machine lacks for a test."""

import os

import pytest


def skip_where(lack: str) -> None:
    """Skip the test where something is lacking, in this one line; but never in CI, where the test fails."""
    if lack and os.environ.get("CI") == "true":
        pytest.fail(lack, pytrace=False)
    if lack:
        pytest.skip(lack)
