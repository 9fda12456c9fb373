"""Who is driving, from a shell: what `status` shows, and what `send` does under a lease."""

from collections.abc import Iterator

import pytest

from gateway.client import Client
from gateway.people.tools.reach import me
from schemas.telemetry import Mode
from tests.support.child import Child
from tests.support.command import Ended
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import Gateway
from tests.support.heard import states

gateway = gateway_fixture({"watchdog": {"timeout_ms": 1000}})


@pytest.fixture
def anna(gateway: Gateway) -> Iterator[Client]:
    with gateway.client(source="anna") as client:
        states(client).wait(lambda state: state.lease.holder is None)
        client.reset()
        client.stop()
        yield client


def lines(child: Child | Ended) -> list[str]:
    return child.stdout.splitlines()


def test_while_somebody_drives_all_commands_say_who_and_what_can_be_done(gateway: Gateway, anna: Client) -> None:
    with anna.lease():
        for arguments, reason in (
            (("send", "leg", "3", "start", "1", "2", "3"), "not_holder"),
            (("send", "leg", "3", "start", "1", "2", "3", "--hold", "1"), "lease_held"),
            (("reset",), "not_holder"),
        ):
            end = gateway.run(*arguments)
            assert end.returncode == 1
            assert end.stdout.startswith(f"rejected: {reason}: ")
            assert "anna" in end.stdout
            assert "status --follow`), or ask for it or take it on the console's page" in end.stderr
        for stop in ("send servo 31 stop", "estop"):
            assert gateway.run(*stop.split()).returncode == 0, stop


def test_hold_drives_for_its_time(gateway: Gateway, anna: Client) -> None:
    heard = states(anna)
    end = gateway.run("send", "leg", "3", "start", "90", "45", "120", "--hold", "0.3")
    assert lines(end) == ["accepted"]
    held = heard.wait(lambda state: state.lease.holder == me())
    assert held.mode in (Mode.IDLE, Mode.ACTIVE)
    assert anna.state().lease.holder is None


def test_status_shows_who_drives(gateway: Gateway, anna: Client) -> None:
    assert "Nobody drives." in lines(gateway.run("status"))
    with anna.lease():
        assert "anna drives." in lines(gateway.run("status"))
