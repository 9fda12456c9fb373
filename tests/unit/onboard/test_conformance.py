"""`check --wire`: what a plug-in does not keep is found by the step that looks for it."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.host import settings_table
from gateway.onboard.check import conformance
from gateway.wire import Capabilities, ServoWire

Changes = Sequence[tuple[int, float | None]]


class Board(ServoWire):
    """One that keeps all; each breaks something."""

    calls: list[Changes]
    opened = 0

    def open(self) -> None:
        Board.opened += 1

    def apply(self, changes: Changes) -> None:
        Board.calls.append(changes)

    def close(self) -> None:
        pass


class Whole(Board):
    capabilities = Capabilities(whole_robot=True)

    def apply(self, changes: Changes) -> None:
        assert len(changes) == 18
        super().apply(changes)


class Absent(Board):
    def open(self) -> None:
        raise OSError("no such board")


class OnceOnly(Board):
    def open(self) -> None:
        if Board.opened:
            raise OSError("is in use")
        super().open()


class WholeDegrees(Board):
    def apply(self, changes: Changes) -> None:
        if any(angle_deg is not None and angle_deg % 1 for _, angle_deg in changes):
            raise TypeError("whole degrees, please")


class Deaf(Board):
    def apply(self, changes: Changes) -> bool:  # type: ignore[override]
        return not changes


class ClosesOnce(Board):
    _open = False

    def open(self) -> None:
        self._open = True

    def close(self) -> None:
        if not self._open:
            raise ValueError("it is not open")
        self._open = False


class Slow(Board):
    def apply(self, changes: Changes) -> None:
        time.sleep(0.025 if changes[0][1] is None else 0)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conformance, "_HOLD_S", 0)
    monkeypatch.setattr(conformance, "_ROUNDS", 2)
    monkeypatch.setattr(Board, "opened", 0)
    monkeypatch.setattr(Board, "calls", [], raising=False)


@pytest.fixture
def judged(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str]]:
    def run(kind: type[ServoWire], *, unplug: bool = False) -> tuple[int, str]:
        monkeypatch.setattr(settings_table, "load_plugin", lambda _name, options: kind(options))
        monkeypatch.setattr(conformance, "_LATE_MS", 20.0 if kind is Slow else 10_000.0)
        (tmp_path / "gateway.toml").write_text('wire.name = "board"')
        code = conformance.conformance(tmp_path / "gateway.toml", agreed=True, unplug=unplug)
        return code, capsys.readouterr().out

    return run


@pytest.mark.parametrize("kind", [Board, Whole])
def test_a_plugin_that_keeps_the_contract_ends_stopped(
    kind: type[ServoWire], judged: Callable[..., tuple[int, str]]
) -> None:
    code, said = judged(kind)
    assert code == 0, said
    assert "board keeps it all" in said
    assert Board.calls[-1] == conformance._STOPS


@pytest.mark.parametrize(
    ("kind", "line"),
    [
        (OnceOnly, "FAIL     stop-servos    OSError: is in use"),
        (WholeDegrees, "FAIL     hundredths     TypeError: whole degrees, please"),
        (Deaf, "FAIL     stops          apply returned False: nobody reads it"),
        (ClosesOnce, "FAIL     reopen         ValueError: it is not open"),
        (Slow, "FAIL     times          Stops took up to "),
    ],
)
def test_each_broken_promise_of_a_plugin_is_named(
    kind: type[ServoWire], line: str, judged: Callable[..., tuple[int, str]]
) -> None:
    code, said = judged(kind)
    assert code == 1
    assert line in said
    assert "NOT kept" in said


def test_after_a_plugin_that_does_not_open_nothing_else_is_tried(judged: Callable[..., tuple[int, str]]) -> None:
    code, said = judged(Absent)
    assert code == 1
    assert said.count("FAIL") == 1, said
    assert "board does not open, so nothing else was tried" in said


def test_an_unplugged_board_has_to_raise(
    monkeypatch: pytest.MonkeyPatch, judged: Callable[..., tuple[int, str]]
) -> None:
    monkeypatch.setattr(conformance, "_UNPLUGGED_S", 0.05)
    plugged = True

    def answer(question: str) -> str:
        nonlocal plugged
        plugged = "Plug the board in again" in question
        return ""

    class Unplugged(Board):
        def apply(self, _changes: Changes) -> None:
            if not plugged:
                raise OSError("it does not answer")

    monkeypatch.setattr(conformance, "ask", answer)
    assert "FAIL     unplugged      apply raises no OSError" in judged(Board, unplug=True)[1]
    plugged = True
    assert judged(Unplugged, unplug=True)[0] == 0


def test_nothing_moves_on_a_built_in_wire_or_without_consent(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text('spi.framing = "plain"')
    with pytest.raises(ConfigError, match=r"hexapod-1\.0 is built in"):
        conformance.conformance(file, agreed=True, unplug=False)
    file.write_text('wire.name = "board"')
    monkeypatch.setattr(settings_table, "load_plugin", lambda _name, options: Board(options))
    monkeypatch.setattr(conformance, "ask", lambda _question: "no")
    with pytest.raises(ConfigError, match="nothing was moved"):
        conformance.conformance(file, agreed=False, unplug=False)
    assert Board.calls == []
