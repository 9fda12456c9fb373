"""Who is driving, in a real terminal: the top line, and the keys to ask for the lease and to take it."""

import threading
from pathlib import Path

import pytest

from gateway.people.tools.kept_lease import me
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.tmux import LATE_S, Terminal, need_tmux


@pytest.fixture(autouse=True)
def _tmux(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_tmux()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


gateway = gateway_fixture({"watchdog": {"timeout_ms": 10_000}}, scope="function")


def test_it_shows_the_holder_asks_takes_and_lets_go_at_its_end(gateway: Gateway, tmp_path: Path) -> None:
    asked, lost = threading.Event(), threading.Event()
    with (
        Terminal(tmp_path, [*COMMAND, "watch", "--connect", gateway.endpoint]) as terminal,
        gateway.client(source="anna") as anna,
    ):
        terminal.wait("IDLE", "0 legs running tcp/")
        terminal.press("a")
        terminal.wait("nobody drives, so there is nobody to ask")
        with anna.lease(on_asked=lambda _: asked.set(), on_lost=lambda _: lost.set()):
            assert anna.start_leg(3, 90, 45, 120).accepted
            terminal.wait("ACTIVE 1 leg running anna? drives", "lease_acquired")
            terminal.press("a")
            terminal.wait("anna is asked, and may hand over", f"{me()[:10]}")
            assert asked.wait(LATE_S)
            terminal.press("t")
            terminal.wait("Take it from anna? All six legs stop first.")
            terminal.press("n")
            terminal.wait("not taken")
            assert not lost.is_set()
            terminal.press("t")
            terminal.wait("Take it from anna?")
            terminal.press("y")
            terminal.wait("IDLE", f"{me()} drives: `send` of this user counts", "3 ○ —")
            assert lost.wait(LATE_S)
        assert anna.start_leg(3, 90, 45, 120).reason == "not_holder"
        assert gateway.run("send", "leg", "3", "start", "90", "45", "120").returncode == 0
        terminal.wait("ACTIVE")
        terminal.press("t")
        terminal.wait("released: commands are taken from anyone again")
        assert anna.state().lease.holder is None
        terminal.press("t")
        terminal.wait("Drive? Nobody else's starts, sets and resets count then")
        terminal.press("y")
        terminal.wait("drives: `send` of this user counts")
        assert anna.state().lease.holder == me()
        terminal.press("q")
        assert terminal.wait_for_end() == 0
        assert anna.state().lease.holder is None
    assert not list((tmp_path / "hexapod-gateway").iterdir())
