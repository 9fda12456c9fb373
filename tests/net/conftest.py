"""Where no network can be, its tests are skipped, but fail in CI; a network, a robot and laptops as a fixture."""

from collections.abc import Iterator
from typing import NamedTuple

import pytest

from tests.net.hosts import LaptopHost, RobotHost
from tests.net.namespaces import Network


class Hosts(NamedTuple):
    """A network, and what runs in it."""

    network: Network
    robot: RobotHost
    laptops: tuple[LaptopHost, LaptopHost]


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hosts]:
    """They take seconds to start on a busy machine, so all at once, and once for all tests of a file."""
    with (
        Network(laptops=2) as network,
        LaptopHost(network, 0) as first,
        LaptopHost(network, 1) as second,
        RobotHost(network, tmp_path_factory.mktemp("robot")) as robot,
    ):
        yield Hosts(network, robot, (first.ready(), second.ready()))


@pytest.fixture
def hosts(running: Hosts) -> Hosts:
    """The same, on links that are up, with no stream and nothing running."""
    for number in running.network.laptops:
        running.network.fix(number)
    for laptop in running.laptops:
        laptop.ask("pause")
        laptop.ask("wait_for_reach", within=True)
        laptop.ask("request", "state")  # comes behind whatever was on the way
    running.robot.at_rest()
    return running
