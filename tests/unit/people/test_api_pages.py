"""What `make docs` shows of the Python API: all that a program uses, and nothing that only we use."""

import re
from pathlib import Path
from typing import Final

import pdoc
import pytest

import gateway.client

RETURNED: Final = {"Ack", "Event", "GatewayState", "Kind", "Odometry", "Posture", "Reason", "WalkState"}
OURS: Final = {
    "Button.leave",
    "Client.carry",
    "Client.lease_requests",
    "Lease.token",
    "Odometry.after",
    "Stream.send",
    "Walk.close",
    "Walk.end_now",
    "Walk.use",
}
PROGRAMS: Final = {
    "AsyncWalk.ahead",
    "AsyncWalk.turn",
    "Ack.or_raise",
    "Client.walk",
    "Event.kind",
    "GatewayState.limits",
    "Odometry.heading_rad",
    "Walk.ahead",
    "Walk.turn",
    "WalkState.odometry",
}


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """The names on the page of `gateway.client`."""
    folder = tmp_path_factory.mktemp("pages")
    pdoc.pdoc("gateway.client", output_directory=folder)
    page = (Path(folder) / "gateway" / "client.html").read_text(encoding="utf-8")
    return set(re.findall(r'<a class="(?:class|function|variable)" href="#([^"]+)"', page))


def test_what_methods_return_is_exported_and_shown(shown: set[str]) -> None:
    assert set(gateway.client.__all__) <= shown
    assert shown >= RETURNED


def test_methods_of_our_own_are_not_shown_and_those_of_programs_are(shown: set[str]) -> None:
    assert not OURS & shown
    assert shown >= PROGRAMS
    assert not {name for name in shown if name.endswith("exit_code")}
