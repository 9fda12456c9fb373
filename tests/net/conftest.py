"""Where no network can be, its tests are skipped, but fail in CI; and a fresh network as a fixture."""

import os
from collections.abc import Iterator

import pytest

from tests.net.namespaces import Network, lacks


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip or fail in one line that says why."""
    if item.get_closest_marker("net") and (lack := lacks()):
        if os.environ.get("CI") == "true":
            pytest.fail(lack, pytrace=False)
        pytest.skip(lack)


@pytest.fixture
def network() -> Iterator[Network]:
    """A robot and two laptops."""
    with Network(laptops=2) as network:
        yield network
