"""`hexapod-gateway decode`: the line for each frame, what is wrong with others, and the exit codes."""

import contextlib
import io
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from gateway.cli import app
from gateway.people.commands import decode as decode_command

STOP_32 = "06 02 20 02 00 00"
LEG_3 = "0e 01 1f 01 5a 00 20 03 2d 19 21 02 00 00"
STOP_32_LINE = f"{STOP_32}: ONE SERVO: servo 32 stop"
LEG_3_LINE = f"{LEG_3}: ONE LEG, leg 3: servo 31 start 90.00°, servo 32 set 45.25°, servo 33 stop"


def decode(*arguments: str) -> tuple[int, list[str]]:
    result = CliRunner().invoke(app, ["decode", *arguments])
    assert result.stderr == ""
    return result.exit_code, result.stdout.splitlines()


@pytest.mark.parametrize(("arguments", "lines"), [
    ([STOP_32], [STOP_32_LINE]),
    (["060220020000"], [STOP_32_LINE]),
    (["0x06,0x02,0x20,0x02,0x00,0x00"], [STOP_32_LINE]),
    ([LEG_3.upper()], [LEG_3_LINE]),
    ([LEG_3, STOP_32, LEG_3], [LEG_3_LINE, STOP_32_LINE, LEG_3_LINE]),
    ([(LEG_3 + STOP_32).replace(" ", "")], [LEG_3_LINE, STOP_32_LINE]),
    (["06 02 20 02 5a 63"], ["06 02 20 02 5a 63: ONE SERVO: servo 32 stop"]),
    (["06 02 0b 03 00 05"], ["06 02 0b 03 00 05: ONE SERVO: servo 11 set 0.05°"]),
])  # fmt: skip
def test_legal_frames(arguments: list[str], lines: list[str]) -> None:
    assert decode(*arguments) == (0, lines)


def test_for_programs_each_frame_is_an_object() -> None:
    code, lines = decode("--json", LEG_3, STOP_32, "06")
    servos = [{"id": 31, "op": "start", "angle_deg": 90.0}, {"id": 32, "op": "set", "angle_deg": 45.25}]
    whole = {"bytes": LEG_3.replace(" ", ""), "leg": 3, "servos": [*servos, {"id": 33, "op": "stop"}]}
    fault = {"bytes": "06", "fault": "byte 2 is missing; a frame starts with FRAME LEN and FRAME TYPE"}
    single = {"bytes": STOP_32.replace(" ", ""), "leg": 3, "servos": [{"id": 32, "op": "stop"}]}
    assert (code, [json.loads(line) for line in lines]) == (1, [whole, single, fault])
    assert decode("--json", "zz") == (1, [json.dumps({"fault": '"zz" is not hexadecimal'})])


@pytest.mark.parametrize(("arguments", "lines"), [
    ([""], ["nothing: not legal: byte 1 is missing; a frame starts with FRAME LEN and FRAME TYPE"]),
    (["06 02 20 02 00"], ["06 02 20 02 00: not legal: byte 6 is missing; a ONE SERVO frame has 6 bytes, here are 5"]),
    ([STOP_32, "07"], [STOP_32_LINE, "07: not legal: byte 2 is missing; a frame starts with FRAME LEN and FRAME TYPE"]),
    # half a byte is not completed by a guess, nor by its neighbour: 0,0 is not 00
    (["6 2 20 2 0 0"], ['"6" ends with half a byte; a byte has two digits, such as 06']),
    (["0x06,0x02,0x20,0x02,0,0"], ['"0" ends with half a byte; a byte has two digits, such as 06']),
    (["zz"], ['"zz" is not hexadecimal']),
    (["٠٦"], ['"٠٦" is not hexadecimal']),
    (["06 02 0x0x"], ['"0x0x" is not hexadecimal']),
    (["\x1b[2J"], [r'"\u001b[2J" is not hexadecimal']),
    (["g" * 500], [f'"{"g" * 79}… is not hexadecimal']),
])  # fmt: skip
def test_what_is_not_legal(arguments: list[str], lines: list[str]) -> None:
    assert decode(*arguments) == (1, lines)


def test_no_argument_is_a_mistake_of_usage() -> None:
    assert CliRunner().invoke(app, ["decode"]).exit_code == 2


@given(st.lists(st.text(st.characters(exclude_characters="\0", exclude_categories=())) | st.binary().map(bytes.hex)))
def test_whatever_is_typed_prints_lines_that_any_terminal_takes(typed: list[str]) -> None:
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        code = decode_command.decode(typed)
    lines = printed.getvalue().splitlines()
    assert lines
    assert all(line.isprintable() for line in lines)
    assert code == any(": ONE " not in line for line in lines)
