"""A plugin for pytest-xdist: it hands groups of tests to workers, in the order of the tests."""

from typing import Any

import pytest
from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

from tests.support import schedule


class Workers(LoadScopeScheduling):  # type: ignore[misc]  # xdist says nothing of its types
    """Distributes tests by the groups of the schedule."""

    def __init__(self, config: pytest.Config, log: Any = None) -> None:
        super().__init__(config, log)
        config.option.loadscopereorder = False

    def remove_node(self, node: WorkerController) -> str | None:
        """Give an ended worker's tests to the others. Returns the test that ended it.

        That one does not run again: it would end the next worker, too.
        """
        work = self.assigned_work.pop(node)
        ended: str | None = None
        for unit in work.values():
            for test, is_completed in unit.items():
                if ended is None and not is_completed:
                    ended, unit[test] = test, True
        self.workqueue.update({scope: unit for scope, unit in work.items() if not all(unit.values())})
        for other in self.assigned_work:
            self._reschedule(other)
        return ended

    def _reschedule(self, node: WorkerController) -> None:
        if node in self.registered_collections:  # not a worker that has just taken an ended one's place
            super()._reschedule(node)

    def _split_scope(self, nodeid: str) -> str:
        return schedule.group(nodeid)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Workers:
    return Workers(config, log)
