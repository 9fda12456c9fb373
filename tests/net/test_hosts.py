"""A robot with two addresses, of which one leads nowhere: from the beginning, or from some moment on.

What is promised is a Stop at most half a second later than by an address that works. Measured figures are printed
(`pytest -rP`); the tests allow as much again, since they share the machine.
"""

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from schemas.robot import LEGS
from schemas.telemetry import Mode
from tests.net.hosts import PORT, TIMEOUT_MS, LaptopHost
from tests.net.namespaces import Network
from tests.support.gateway_process import Gateway

pytestmark = pytest.mark.net

LEASE_MS = 1000
"""As the files have it that `certs` writes."""
LATER_S = 0.5
SLACK_S = 0.5
BACK_S = 15
"""The lost host takes its second as a rule. Zenoh has been seen to spend its ten on it (once in some twenty runs); the
Stop does not wait for that."""


@pytest.fixture(scope="module")
def addresses(hosts_network: Network, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str]]:
    """The robot's two, with a gateway on both."""
    folder = tmp_path_factory.mktemp("robot")
    both = hosts_network.robot_address(0), hosts_network.another_address(0)
    listen = [f"tcp/{address}:{PORT}" for address in both]
    config = folder / "zenoh.json5"
    config.write_text(json.dumps({"transport": {"link": {"tx": {"lease": LEASE_MS}}}}))
    settings: dict[str, dict[str, Any]] = {
        "zenoh": {"listen": listen, "allow_insecure": True, "config": str(config)},
        "watchdog": {"timeout_ms": TIMEOUT_MS},
    }
    with Gateway(folder, settings, prefix=hosts_network.robot):
        yield both


def hosts_file(folder: Path, *hosts: str) -> Path:
    """A laptop's file, as `certs issue` writes it but for the certificates."""
    path = folder / "laptop.json5"
    connect = {"endpoints": [f"tcp/{host}:{PORT}" for host in hosts]}
    transport = {"unicast": {"open_timeout": 1000}, "link": {"tx": {"lease": LEASE_MS}}}
    path.write_text(json.dumps({"mode": "client", "connect": connect, "transport": transport}))
    return path


@pytest.mark.nightly
def test_a_stop_finds_the_other_host_in_mid_stream(
    hosts_network: Network, addresses: tuple[str, str], tmp_path: Path
) -> None:
    """The host in use is lost without a word. The Stop is first, and the session with its stream comes behind it."""
    config = hosts_file(tmp_path, hosts_network.nowhere(0), *addresses)
    took_ms: list[float] = []
    with LaptopHost(hosts_network, 0, zenoh_config=config) as laptop:
        laptop.ask("in-reach")
        for lost in addresses:
            laptop.ask("reset")
            laptop.start(*LEGS)
            laptop.stream(*LEGS)
            laptop.ask("sent 100")
            hosts_network.lose(0, lost)
            answer = laptop.ask("estop")
            assert answer["stop_frames"] == len(LEGS)
            took_ms.append(answer["answered_ms"])
            laptop.ask("out-of-reach")
            begun_s = time.monotonic()
            laptop.ask("in-reach")
            back_s = time.monotonic() - begun_s
            print(f"back after {back_s:.2f} s; the Stop was confirmed after {took_ms[-1]:.0f} ms")
            assert back_s < BACK_S
            assert laptop.ask("state")["mode"] == Mode.ESTOPPED
            laptop.ask("pause")
            hosts_network.find(0, lost)
    assert max(took_ms) < (LATER_S + SLACK_S) * 1000
