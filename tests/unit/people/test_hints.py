"""Lines that a person copies from what a command said: they are what was meant, and they are found."""

import sys
from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.people.terminal import this_command
from gateway.people.tools.send import connection, send_leg, send_servo

NOWHERE = connection("tcp/127.0.0.1:1", None, 1)


@pytest.mark.parametrize(("op", "angles_deg", "example"), [
    ("stop", (1.0,), "send leg 4 stop"),
    ("set", (1.0,), "send leg 4 set 90 45 120"),
    ("start", (), "send leg 4 start 90 45 120"),
])  # fmt: skip
def test_the_example_is_of_the_operation_that_was_meant(op: str, angles_deg: tuple[float, ...], example: str) -> None:
    with pytest.raises(ConfigError) as error:
        send_leg(NOWHERE, 4, op, angles_deg, hold_s=0)
    assert str(error.value).endswith(f"for example: {example}")


@pytest.mark.parametrize(("op", "angle_deg", "example"), [
    ("stop", 1.0, "send servo 41 stop"),
    ("set", None, "send servo 41 set 90"),
])  # fmt: skip
def test_the_same_for_a_servo(op: str, angle_deg: float | None, example: str) -> None:
    with pytest.raises(ConfigError) as error:
        send_servo(NOWHERE, 41, op, angle_deg, hold_s=0)
    assert str(error.value).endswith(f"for example: {example}")


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
