"""What a command prints: lines that a person can copy, and nothing by which a stranger's words control the terminal."""

import sys
from pathlib import Path

import pytest

from gateway.people.terminal import hint, say, this_command
from tests.support.command import run_here

EVIL = "eve\x1b[2J\x1b]0;owned\x07\r\naccepted"
SHOWN = r"eve\x1b[2J\x1b]0;owned\x07\r\naccepted"


def test_what_strangers_wrote_is_shown_on_one_line_and_does_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    say(f"{EVIL} drives")
    hint(f"{EVIL} asks")
    assert capsys.readouterr() == (f"{SHOWN} drives\n", f"{SHOWN} asks\n")


def test_nor_does_it_in_an_error() -> None:
    end = run_here("run", "--config", "/nowhere\x1b[2J.toml")
    assert end == (2, "", "hexapod-gateway: /nowhere\\x1b[2J.toml: there is no such file; name another with --config\n")


def test_a_program_that_is_not_on_the_path_is_named_as_it_was_called(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "hexapod-gateway"
    program.touch(mode=0o755)
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setattr(sys, "argv", [str(program)])
    assert this_command() == str(program)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert this_command() == "hexapod-gateway"
