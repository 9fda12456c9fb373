"""Zenoh receives each session on a thread of its own, so that none waits for another that floods."""

from pathlib import Path

import pytest

from gateway.limits import MAX_SESSIONS
from gateway.robot.zenoh_io.session import RUNTIME
from tests.support.gateway_process import Gateway


def receiving_threads(gateway: Gateway) -> int:
    tasks = Path(f"/proc/{gateway.child.pid}/task").iterdir()
    return sum((task / "comm").read_text().startswith("rx-") for task in tasks)


@pytest.mark.parametrize(("own", "expected"), [(None, MAX_SESSIONS), ("(rx:(worker_threads:3))", 3)])
def test_each_session_has_a_receiving_thread_unless_the_environment_says_otherwise(
    tmp_path: Path, own: str | None, expected: int
) -> None:
    with Gateway(tmp_path, env=None if own is None else {"ZENOH_RUNTIME": own}) as gateway, gateway.client() as client:
        assert client.state()
        assert receiving_threads(gateway) == expected


def test_the_unit_allows_these_threads_and_the_gateways_own() -> None:
    unit = (Path(__file__).parents[2] / "deploy/systemd/hexapod-gateway.service").read_text()
    (most,) = [line.partition("=")[2] for line in unit.splitlines() if line.startswith("TasksMax=")]
    assert str(MAX_SESSIONS) in RUNTIME
    assert int(most) >= MAX_SESSIONS + 40, "an hour of load had 18 to 20 besides Zenoh's two"
