"""What all tests share: Hypothesis's patience, the event loop (`virtual_time`: it leaps to its next timer), and the
model check, which begins early."""

import asyncio
import os
from collections.abc import Callable, Iterator, Mapping
from multiprocessing import get_context
from multiprocessing.pool import AsyncResult

import async_solipsism
import pytest
from hypothesis import HealthCheck
from hypothesis import settings as hypothesis_settings

from tests.support.model_check import Report, check
from tests.support.small_robots import CONFIGURATIONS

# A busy machine is no fault of the code under test: what may not take long has a test of its own, with a bound.
hypothesis_settings.register_profile(
    "any machine", hypothesis_settings(), deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
hypothesis_settings.load_profile("any machine")


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> Mapping[str, Callable[[], asyncio.AbstractEventLoop]]:
    """pytest-asyncio's hook."""
    del config
    if item.get_closest_marker("virtual_time"):
        return {"virtual": async_solipsism.EventLoop}
    return {"real": asyncio.new_event_loop}


_ORDER = ("attack", "box", "hil", "net", "console", "zenoh", "mutants", "unit", "fuzz")
"""First what measures time, with both processors for itself; last what waits for the searches."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """pytest's hook: folders in their order, any other before them."""
    places = {folder: place for place, folder in enumerate(_ORDER)}
    items.sort(key=lambda item: places.get(item.path.parent.name, -1))


@pytest.fixture(scope="session")
def searches() -> Iterator[Mapping[str, AsyncResult[Report]]]:
    """The model check's searches by configuration, on all processors; the last have most states, and so begin first."""
    with get_context("spawn").Pool(initializer=os.nice, initargs=(19,)) as pool:
        yield {each.name: pool.apply_async(check, (each,)) for each in reversed(CONFIGURATIONS)}


@pytest.fixture(scope="module", autouse=True)
def _search_ahead(request: pytest.FixtureRequest) -> None:
    """Begin the searches, where they are wanted: two minutes of a processor, which most tests leave idle.

    Not beside tests with hardware, network or systemd, which run before all others.
    """
    wanted = any("searches" in getattr(item, "fixturenames", ()) for item in request.session.items)
    if wanted and request.path.parent.name in _ORDER[_ORDER.index("zenoh") :]:
        request.getfixturevalue("searches")
