"""A plugin for pytest-xdist: it hands groups of tests to workers, in the order of the tests."""

from typing import Any

import pytest
from xdist.scheduler import LoadScopeScheduling

from tests.support import schedule


class Workers(LoadScopeScheduling):  # type: ignore[misc]  # xdist says nothing of its types
    """By the groups of the schedule."""

    def __init__(self, config: pytest.Config, log: Any = None) -> None:
        super().__init__(config, log)
        config.option.loadscopereorder = False

    def _split_scope(self, nodeid: str) -> str:
        return schedule.group(nodeid)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Workers:
    """pytest-xdist's hook."""
    return Workers(config, log)
