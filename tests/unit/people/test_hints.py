"""What a command prints: lines that a person can copy, and nothing by which a stranger's words control the terminal."""

import ast
import re
import sys
from pathlib import Path
from typing import Final

import pytest

from gateway.people.terminal import hint, say
from gateway.words.own_command import CONNECT_VARIABLE, DEFAULT_ENDPOINT, command, reach_by, this_command
from tests.support.command import run_here
from tests.support.pages import texts

EVIL = "eve\x1b[2J\x1b]0;owned\x07\r\naccepted"
SHOWN = r"eve\x1b[2J\x1b]0;owned\x07\r\naccepted"


def test_what_strangers_wrote_is_shown_on_one_line_and_does_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    say(f"{EVIL} drives")
    hint(f"{EVIL} asks")
    assert capsys.readouterr() == (f"{SHOWN} drives\n", f"{SHOWN} asks\n")


def test_control_characters_in_an_error_are_escaped() -> None:
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


@pytest.mark.parametrize(
    ("connect", "zenoh_config", "variable", "options"),
    [
        (None, None, None, ""),
        (DEFAULT_ENDPOINT, None, None, ""),
        (DEFAULT_ENDPOINT, None, "tcp/192.0.2.7:7447", f" --connect {DEFAULT_ENDPOINT}"),
        ("tcp/192.0.2.7:7447", None, None, " --connect tcp/192.0.2.7:7447"),
        ("tcp/[::1]:7447", Path("my robot.json5"), None, " --connect 'tcp/[::1]:7447' --zenoh-config 'my robot.json5'"),
    ],
)
def test_a_command_carries_the_endpoint_that_it_needs(
    monkeypatch: pytest.MonkeyPatch, connect: str | None, zenoh_config: Path | None, variable: str | None, options: str
) -> None:
    """The default is left out, unless the shell in which the command is run may have another one."""
    if variable is not None:
        monkeypatch.setenv(CONNECT_VARIABLE, variable)
    reach_by(connect=connect, zenoh_config=zenoh_config)
    try:
        assert command("reset") == f"{this_command()} reset{options}"
    finally:
        reach_by(connect=None, zenoh_config=None)


GATEWAY: Final = Path(__file__).parents[3] / "gateway"
REACHES: Final = re.compile(r"\b(status|console|walk|send|stop|estop|reset|check|calibrate|record|ros2)\b")
ENOUGH: Final = re.compile("--connect|--zenoh-config|--link|--listen|--sim|sudo")


def test_commands_that_reach_a_gateway_are_built_in_one_place() -> None:
    by_hand = [
        f"{path.relative_to(GATEWAY)}: {text}"
        for path in GATEWAY.rglob("*.py")
        if re.search(r"hexapod-gateway [a-z]|this_command\(\)\}", source := path.read_text(encoding="utf-8"))
        for text in texts(source, lambda value: ast.unparse(value)[2:-1])
        for found in re.finditer(r"(hexapod-gateway|this_command\(\)\}*) (?P<command>[a-z-]+)", text)
        if REACHES.fullmatch(found["command"]) and text != found[0] and not ENOUGH.search(text)
    ]
    assert not by_hand


@pytest.mark.parametrize("arguments", [("certs", "list"), ("incidents",), ("console", "--link")])
def test_a_user_without_a_home_gets_a_sentence(arguments: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """A container's: no HOME, and no entry in passwd."""

    def no_entry(number: int) -> None:
        raise KeyError(number)

    for name in ("HOME", "XDG_STATE_HOME", "STATE_DIRECTORY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", no_entry)
    end = run_here(*arguments)
    assert end.returncode == 2
    assert end.stderr.startswith("hexapod-gateway: this user has no home folder")
