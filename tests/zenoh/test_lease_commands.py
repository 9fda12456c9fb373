"""Who is driving, from a shell: what the commands print, and what `send` does under a lease."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.client import Client
from gateway.people.tools.kept_lease import me
from schemas.telemetry import Mode
from tests.support.child import Child
from tests.support.command import Ended
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import Gateway
from tests.support.heard import states

UNVERIFIED = "(a name that nobody has verified)"


gateway = gateway_fixture({"watchdog": {"timeout_ms": 1000}})


@pytest.fixture(autouse=True)
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A login of its own: what a shell's lease leaves behind."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path


@pytest.fixture
def anna(gateway: Gateway) -> Iterator[Client]:
    with gateway.client(source="anna") as client:
        states(client).wait(lambda state: state.lease.holder is None)
        client.reset()
        client.stop()
        yield client


def lines(child: Child | Ended) -> list[str]:
    return child.stdout.splitlines()


def kept(runtime: Path) -> list[Path]:
    return list((runtime / "hexapod-gateway").glob("*"))


def test_acquire_holds_it_while_send_and_reset_of_the_same_user_drive(
    gateway: Gateway, anna: Client, runtime: Path
) -> None:
    with gateway.begin("lease", "acquire") as holder:
        assert holder.wait_for_line(0) == f"{me()} drives {UNVERIFIED}\n"
        assert anna.state().lease.holder == me()
        assert lines(gateway.run("lease", "acquire")) == [
            "rejected: lease_held: this user holds it already, in another terminal"
        ]
        assert anna.start_leg(1, 1, 2, 3).reason == "not_holder"
        assert lines(gateway.run("send", "leg", "3", "start", "90", "45", "120")) == ["accepted"]
        assert anna.estop().accepted
        assert lines(gateway.run("reset")) == ["reset; nothing moves until it is started again"]
        assert lines(gateway.run("lease", "status"))[0].startswith(f"{me()} drives {UNVERIFIED}, for ")
        (file,) = kept(runtime)
        assert (file.stat().st_mode & 0o777, file.parent.stat().st_mode & 0o777) == (0o600, 0o700)
        token = file.read_text()
        holder.send_signal(signal.SIGINT)
        assert holder.wait() == 0
        assert lines(holder)[-1] == "released"
        assert token not in str(holder)
    assert not kept(runtime)
    assert anna.state().lease.holder is None


def test_release_in_another_terminal_ends_it(gateway: Gateway, anna: Client, runtime: Path) -> None:
    with gateway.begin("lease", "acquire") as holder:
        holder.wait_for_line(0)
        assert lines(gateway.run("lease", "release")) == ["released"]
        assert holder.wait() == 0
        assert lines(holder)[-1] == "released elsewhere"
    assert not kept(runtime)
    assert anna.start_leg(1, 1, 2, 3).accepted
    end = gateway.run("lease", "release")
    assert (end.returncode, lines(end)) == (
        1,
        ["rejected: no_lease: this user holds no lease of that robot on this machine"],
    )


def test_for_a_time(gateway: Gateway, anna: Client) -> None:
    end = gateway.run("lease", "acquire", "--for", "0.1")
    assert (end.returncode, lines(end)) == (0, [f"{me()} drives {UNVERIFIED}", "released"])
    assert anna.state().lease.holder is None


def test_while_somebody_drives_all_commands_say_who_and_what_can_be_done(gateway: Gateway, anna: Client) -> None:
    with anna.lease():
        for arguments, reason in (
            (("send", "leg", "3", "start", "1", "2", "3"), "not_holder"),
            (("send", "leg", "3", "start", "1", "2", "3", "--hold", "1"), "lease_held"),
            (("reset",), "not_holder"),
            (("lease", "acquire"), "lease_held"),
        ):
            end = gateway.run(*arguments)
            assert end.returncode == 1
            assert end.stdout.startswith(f"rejected: {reason}: ")
            assert "anna" in end.stdout
            assert "lease ask` asks for it; `lease take` takes it by force" in end.stderr
        for stop in ("send servo 31 stop", "estop"):
            assert gateway.run(*stop.split()).returncode == 0, stop


def test_hold_drives_for_its_time(gateway: Gateway, anna: Client) -> None:
    heard = states(anna)
    end = gateway.run("send", "leg", "3", "start", "90", "45", "120", "--hold", "0.3")
    assert lines(end) == ["accepted"]
    held = heard.wait(lambda state: state.lease.holder == me())
    assert held.mode in (Mode.IDLE, Mode.ACTIVE)
    assert anna.state().lease.holder is None


def test_ask_waits_to_be_handed_it(gateway: Gateway, anna: Client) -> None:
    def hand_over(who: str) -> None:
        lease.hand_over(who)

    with anna.lease(on_asked=hand_over) as lease, gateway.begin("lease", "ask") as asker:
        assert asker.wait_for_line(0) == f"{me()} drives {UNVERIFIED}\n"
        assert "anna drives, and is asked" in asker.stderr
        assert anna.state().lease.holder == me()
        asker.terminate()
        assert asker.wait() == 0


def test_who_asks_a_shell_is_told_to_it_and_can_be_handed_it(gateway: Gateway, anna: Client) -> None:
    with gateway.begin("lease", "acquire") as holder:
        holder.wait_for_line(0)
        assert anna.ask_for_lease().accepted
        holder.wait_for_output("anna asks for the lease: `")
        assert lines(gateway.run("lease", "status"))[1] == "anna asks for it"
        assert lines(gateway.run("lease", "release", "--to", "anna")) == ["handed over to anna"]
        with anna.lease() as lease:
            assert lease.held
        assert holder.wait() == 0


def test_take_says_whom_it_stops_and_wants_a_yes(gateway: Gateway, anna: Client) -> None:
    with anna.lease() as lease:
        assert anna.start_leg(3, 90, 45, 120).accepted
        end = gateway.run("lease", "take")
        assert end.returncode == 2
        assert "anna drives" in end.stderr
        assert "1 leg running" in end.stderr
        assert "say --yes to take it" in end.stderr
        assert lease.held
        heard = states(anna)
        with gateway.begin("lease", "take", "--yes") as taker:
            assert taker.wait_for_line(0) == f"{me()} drives {UNVERIFIED}\n"
            heard.wait(lambda state: state.mode is Mode.IDLE)
            assert lease.confirm() is not None


def test_a_shell_that_was_killed_leaves_nothing_that_stands_in_the_way(
    gateway: Gateway, anna: Client, runtime: Path
) -> None:
    with gateway.begin("lease", "acquire") as holder:
        holder.wait_for_line(0)
        holder.kill()
    assert len(kept(runtime)) == 1
    states(anna).wait(lambda state: state.lease.holder is None)
    assert lines(gateway.run("send", "leg", "3", "start", "90", "45", "120")) == ["accepted"]
    assert not kept(runtime)
