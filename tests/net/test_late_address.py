"""An address that comes late, or an address family that the kernel lacks: the gateway listens on what is there."""

import os
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.net.namespaces import Network
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, Gateway, free_port

pytestmark = pytest.mark.net


def test_what_is_there_is_listened_on_and_the_rest_as_soon_as_it_comes(tmp_path: Path) -> None:
    """In one session: who is connected stays so. A page of metrics waits likewise."""
    port, page, late = free_port(), free_port(), "10.77.0.3"
    here, there = f"tcp/127.0.0.1:{port}", f"tcp/{late}:{port}"
    settings: dict[str, dict[str, Any]] = {
        "zenoh": {"listen": [there, here], "allow_insecure": True},
        "telemetry": {"metrics": f"{late}:{page}"},
    }
    with Network() as network, Gateway(tmp_path, settings, prefix=network.robot) as gateway:
        gateway.child.wait_for_output(f"does not listen on {there} yet: Cannot assign requested")
        with Child([*network.robot, *COMMAND, "status", "--follow", "--connect", here], os.environ) as inside:
            inside.wait_for_output(f"Does not listen on tcp/{late}:{page}, {there} yet: the address is not there.")
            assert network.another_address(0) == late
            gateway.child.wait_for_output(f"listens on {there}, too")
            gateway.child.wait_for_output(f"listens on tcp/{late}:{page}, too")
            with Child([*network.laptop(0), *COMMAND, "status", "--connect", there], os.environ) as outside:
                assert outside.wait() == 0
                assert "Does not listen" not in outside.stdout
            with Child([*network.robot, *COMMAND, "estop", "--connect", here], os.environ) as estop:
                assert estop.wait() == 0
            inside.wait_for_output("estop_engaged")
            assert "silent" not in inside.stdout, "its session went on"


def test_a_gateway_that_listens_nowhere_says_that_nobody_can_reach_it(tmp_path: Path) -> None:
    """On ::1 alone, without IPv6: until the kernel has it."""
    there = f"tcp/[::1]:{free_port()}"
    with Network() as network:
        network.ipv6(on=False)
        with Gateway(tmp_path, {"zenoh": {"listen": [there]}}, prefix=network.robot) as gateway:
            gateway.child.wait_for_output("nobody can reach this gateway, since it listens nowhere: set zenoh.listen")
            network.ipv6(on=True)
            gateway.child.wait_for_output(f"listens on {there}, too")
            with Child([*network.robot, *COMMAND, "status", "--connect", there], os.environ) as status:
                assert status.wait() == 0


@pytest.mark.parametrize(("listen", "missing"), [("tcp/[::]:{}", False), ("tcp/[::1]:{}", True)])
def test_without_ipv6_it_listens_by_ipv4(tmp_path: Path, listen: str, missing: bool) -> None:
    """On all addresses, where the file names all; what certs makes does."""
    port = free_port()
    here, given = f"tcp/127.0.0.1:{port}", listen.format(port)
    settings = {"zenoh": {"listen": [given, *([here] if missing else [])], "allow_insecure": True}}
    with Gateway(tmp_path, settings, prefix=(sys.executable, "-m", "tests.support.without_ipv6")) as gateway:
        with Child([*COMMAND, "status", "--follow", "--connect", here], os.environ) as status:
            status.wait_for_output(f"Does not listen on {given} yet" if missing else "Nobody drives.")
            assert ("Does not listen" in status.stdout) is missing
        if missing:
            gateway.child.wait_for_output(f"does not listen on {given} yet")
        else:
            assert "does not listen on" not in gateway.child.stderr
