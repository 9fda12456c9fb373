"""The network itself: it is there, it is cut and fixed, and it never outlives the test."""

import os
import subprocess
import sys

import pytest

from tests.net.namespaces import Network
from tests.support.child import Child

pytestmark = pytest.mark.net

ABANDON = (
    "import sys; from tests.net.namespaces import Network; print(Network(1).robot[-1], flush=True); sys.stdin.read()"
)


def namespaces() -> str:
    return subprocess.run(["ip", "netns", "list"], capture_output=True, text=True, check=True).stdout


def carrier(network: Network, laptop: int) -> str:
    command = [*network.laptop(laptop), "cat", "/sys/class/net/robot/carrier"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def test_each_laptop_has_a_link_of_its_own_and_all_is_removed_at_the_end() -> None:
    with Network(laptops=2) as network:
        assert network.robot[-1] in namespaces()
        assert (carrier(network, 0), carrier(network, 1)) == ("1", "1")
        network.cut(0)
        assert (carrier(network, 0), carrier(network, 1)) == ("0", "1")
        network.fix(0)
        assert carrier(network, 0) == "1"
    assert network.robot[-1] not in namespaces()
    assert network.laptop(1)[-1] not in namespaces()


def test_what_a_killed_process_left_behind_is_removed_by_the_next() -> None:
    child = Child([sys.executable, "-c", ABANDON], os.environ)
    left = child.wait_for_line(0).strip()
    with Network(laptops=1):
        assert left in namespaces(), "its process still runs"
    child.kill()
    child.close()
    with Network(laptops=1):
        assert left not in namespaces()
