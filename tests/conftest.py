"""What all tests share: Hypothesis's patience, the event loop (`virtual_time`: it leaps to its next timer), and the
model check, which begins early."""

import asyncio
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from multiprocessing import get_context
from multiprocessing.pool import AsyncResult
from pathlib import Path

import async_solipsism
import pytest
from hypothesis import HealthCheck
from hypothesis import settings as hypothesis_settings

from tests.support import schedule
from tests.support.model_check import Report, check
from tests.support.small_robots import CONFIGURATIONS

# A busy machine is no fault of the code under test: what may not take long has a test of its own, with a bound.
hypothesis_settings.register_profile(
    "any machine", hypothesis_settings(), deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
hypothesis_settings.load_profile("any machine")


def pytest_configure(config: pytest.Config) -> None:
    """pytest's hook."""
    # Hundreds of processes begin here, and half of a start is to compile the gateway, where nobody keeps the result.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False
    if config.pluginmanager.hasplugin("xdist"):
        config.pluginmanager.import_plugin("tests.support.workers")
    # What `nohup`, or a shell's `&`, lets a program ignore is undone: tests send these signals.
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGQUIT):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> Mapping[str, Callable[[], asyncio.AbstractEventLoop]]:
    """pytest-asyncio's hook."""
    del config
    if item.get_closest_marker("virtual_time"):
        return {"virtual": async_solipsism.EventLoop}
    return {"real": asyncio.new_event_loop}


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """pytest's hook."""
    return schedule.is_elsewhere(collection_path, config.option.markexpr) or None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """pytest's hook."""
    del config
    schedule.arrange(items)


@pytest.fixture(scope="session")
def searches() -> Iterator[Mapping[str, AsyncResult[Report]]]:
    """The model check's searches by configuration; the last have most states, and so begin first."""
    with get_context("spawn").Pool(initializer=schedule.give_way) as pool:
        yield {each.name: pool.apply_async(check, (each,)) for each in reversed(CONFIGURATIONS)}


@pytest.fixture(scope="module", autouse=True)
def _search_ahead(request: pytest.FixtureRequest) -> None:
    """Begin the searches, where they are wanted: most tests that run alone leave a processor idle."""
    wanted = any("searches" in getattr(item, "fixturenames", ()) for item in request.session.items)
    if wanted and not hasattr(request.config, "workerinput"):
        request.getfixturevalue("searches")
