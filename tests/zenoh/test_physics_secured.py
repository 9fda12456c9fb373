"""`run --sim=physics` where people need certificates, passwords, or a router: its body is seen, and nobody else's."""

import os
import select
import signal
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest
import zenoh

from gateway.client import Client
from gateway.errors import UnansweredError
from gateway.people.client.live import set_upright
from schemas import keys
from tests.support.gateway_process import Gateway
from tests.support.heard import bodies
from tests.support.secured import Secured

pytestmark = pytest.mark.full

PHYSICS: Final = ("--sim=physics",)


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Secured]:
    with Secured(tmp_path_factory.mktemp("secured"), options=PHYSICS) as made:
        yield made


def test_with_certificates_all_see_it_and_operators_set_it_upright(secured: Secured) -> None:
    with secured.client("anna") as anna, secured.client("otto") as otto:
        seen = bodies(otto)
        lying = seen.wait(lambda _: True)
        assert set_upright(anna).accepted
        seen.wait(lambda body: body.position_m[2] > lying.position_m[2] + 0.005)
        with pytest.raises(UnansweredError):
            set_upright(otto)


def test_with_certificates_nobody_else_publishes_it_or_answers_for_it(secured: Secured) -> None:
    """Zenoh drops both before they reach anybody."""
    asked: list[zenoh.Query] = []
    with secured.client("anna") as anna, secured.client("otto") as otto, secured.session("anna") as stranger:
        seen = bodies(otto)
        forged = seen.wait(lambda _: True).model_copy(update={"position_m": (9.0, 9.0, 9.0)}).model_dump_json()
        stranger.declare_queryable(keys.SIM_UPRIGHT, asked.append)
        for number in range(10):
            stranger.put(keys.SIM_BODY, forged)
            list(stranger.get(keys.STATE))  # the same link: what was put before has passed, or been dropped
            seen.wait(lambda _: True, count=len(seen.all) + number % 2)
        assert set_upright(anna).accepted
        assert all(body.position_m[0] < 9 for body in seen.all)
        assert asked == []


def test_its_socket_is_private_and_goes_with_a_killed_gateway(tmp_path: Path) -> None:
    with Gateway(tmp_path, options=PHYSICS, env={"TMPDIR": str(tmp_path)}) as running:
        (folder,) = tmp_path.glob("hexapod-body-*")
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        assert str(folder) not in running.child.stdout
        (pid,) = Path(f"/proc/{running.child.pid}/task/{running.child.pid}/children").read_text().split()
        pidfd = os.pidfd_open(int(pid))
        os.kill(running.child.pid, signal.SIGKILL)
        assert select.select([pidfd], [], [], 5)[0]
        os.close(pidfd)
        assert not folder.exists()


def test_with_passwords(tmp_path: Path) -> None:
    (tmp_path / "users.txt").write_text("anna:secret\n")
    (tmp_path / "zenoh.json5").write_text('{ transport: { auth: { usrpwd: { dictionary_file: "users.txt" } } } }')
    user = '{ mode: "client", transport: { auth: { usrpwd: { user: "anna", password: "secret" } } } }'
    (tmp_path / "anna.json5").write_text(user)
    settings = {"zenoh": {"config": str(tmp_path / "zenoh.json5")}}
    with (
        Gateway(tmp_path, settings, options=PHYSICS) as running,
        Client(running.endpoint, zenoh_config=tmp_path / "anna.json5", timeout_s=5) as anna,
    ):
        bodies(anna).wait(lambda _: True)
        assert set_upright(anna).accepted
    assert (tmp_path / "users.txt").read_text() == "anna:secret\n"
