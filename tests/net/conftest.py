"""Where no network can be, its tests are skipped, but fail in CI; a network, a robot and laptops as fixtures."""

from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from tests.net.hosts import LaptopHost, RobotHost
from tests.net.namespaces import Network


@pytest.fixture(scope="module")
def hosts_network() -> Iterator[Network]:
    """A robot and two laptops; one for all tests of a file."""
    with Network(laptops=2) as network:
        yield network


@pytest.fixture
def network(hosts_network: Network) -> Network:
    """The same, with all links up."""
    for number in hosts_network.laptops:
        hosts_network.fix(number)
    return hosts_network


@dataclass
class Hosts:
    """What runs in it."""

    robot: RobotHost
    laptops: tuple[LaptopHost, LaptopHost]


@pytest.fixture(scope="module")
def running(hosts_network: Network, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hosts]:
    """The robot and both laptops. They take seconds to start on a busy machine, so all at once, and once for all."""
    with (
        LaptopHost(hosts_network, 0) as first,
        LaptopHost(hosts_network, 1) as second,
        RobotHost(hosts_network, tmp_path_factory.mktemp("robot")) as robot,
    ):
        yield Hosts(robot, (first.ready(), second.ready()))


@pytest.fixture
def hosts(network: Network, running: Hosts) -> Hosts:
    """The same, on links that are up, with no stream and nothing running."""
    del network
    for laptop in running.laptops:
        laptop.ask("pause")
        laptop.ask("in-reach")
        laptop.ask("state")  # comes behind whatever was on the way
    running.robot.at_rest()
    return running


@pytest.fixture
def robot(hosts: Hosts) -> RobotHost:
    """The robot of these."""
    return hosts.robot


@pytest.fixture
def laptops(hosts: Hosts) -> tuple[LaptopHost, LaptopHost]:
    """The laptops of these."""
    return hosts.laptops
