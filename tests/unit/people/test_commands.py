"""What commands print: lines that a person can copy, the state in sentences, frames explained. No gateway is real."""

import ast
import contextlib
import io
import json
import re
import sys
from collections.abc import Callable, Mapping
from datetime import timedelta
from pathlib import Path
from typing import Final

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway import certs
from gateway.people.commands import decode as decode_command
from gateway.people.commands.status import SILENT_AFTER_NS, Follower, NewsLine, sentences
from gateway.people.terminal import hint, say
from gateway.people.watching.dangers import UNCONFIRMED
from gateway.words.own_command import CONNECT_VARIABLE, DEFAULT_ENDPOINT, command, reach_by, this_command
from schemas.config import CalibrationReport, CertificateReport, WireReport
from schemas.gateway_state import ButtonsReport, ControllerReport, GatewayState, LeaseReport, PowerReport
from schemas.telemetry import Battery
from schemas.words import Mode
from tests.support.command import run_here
from tests.support.pages import texts
from tests.support.published import NS_PER_MS, WALL, rejected, state

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


# ---- status: the state in sentences


@pytest.mark.parametrize("mode", [*Mode, "dancing"])
def test_every_mode_is_a_sentence_also_one_of_a_later_version(mode: str) -> None:
    assert sentences(state().model_copy(update={"mode": mode}))[0].endswith(". Gateway 0.1.0, up 10 s.")


def test_what_runs_who_drives_and_what_watches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["./hexapod-gateway", "status"])
    changed = {"lease": LeaseReport(holder="anna", held_s=3.0), "buttons": ButtonsReport(alive=1, required=2)}
    found = sentences(state(mode=Mode.ACTIVE, running={3}).model_copy(update={**changed, "incident": "1-crash"}))
    assert "Leg 3 runs at 90°, 90°, 90°." in found
    assert "anna drives." in found
    assert "Stop buttons: 1 alive, 2 required." in found
    assert "Latest incident: 1-crash (./hexapod-gateway incidents show 1-crash)." in found
    assert (
        "Commands accepted: 0, rejected: 0, passed over: 0, lost: 0; legs stopped by the watchdog (250 ms): 0." in found
    )


@pytest.mark.parametrize(
    ("alive", "age_ms", "sentence"),
    [
        (True, 12.0, "The controller (elkapod-2025) is alive."),
        (False, None, "The controller (elkapod-2025) is SILENT."),
        (False, 1234.0, "The controller (elkapod-2025) is SILENT, its last answer 1.2 s ago."),
    ],
)
def test_a_controller_that_answers_and_its_battery(alive: bool, age_ms: float | None, sentence: str) -> None:
    controller = ControllerReport(alive=alive, age_ms=age_ms)
    battery = Battery(voltage_v=7.4, percent=80)
    changed = {"controller": controller, "battery": battery, "wire": WireReport(name="elkapod-2025")}
    found = sentences(state().model_copy(update=changed))
    assert sentence in found
    assert "Battery: 7.40 V, 80 %." in found
    assert not [line for line in sentences(state()) if line.startswith(("The controller", "Battery"))]


# ---- --follow: which lines come of states, events and silence


class Followed:
    """What is shown, 100 ms after each other."""

    def __init__(self) -> None:
        self.lines: list[NewsLine] = []
        self.follower = Follower(self.lines.append, lambda: self.now_ns)
        self.now_ns = 0

    def after(self, act: Callable[[], None]) -> list[str]:
        count = len(self.lines)
        act()
        return [line.text for line in self.lines[count:]]

    def state(self, published: GatewayState | None = None, changed: Mapping[str, object] | None = None) -> list[str]:
        """Receive a state of a gateway that has been up since the beginning."""
        self.now_ns += 100 * NS_PER_MS
        found = (published or state(self.now_ns / 1e9)).model_copy(update=changed or {})
        return self.after(lambda: self.follower.received_state(found, self.now_ns))

    def token(self, alive: bool) -> list[str]:
        return self.after(lambda: self.follower.received_token(alive))

    def look(self, after_ns: int) -> list[str]:
        self.now_ns += after_ns
        return self.after(self.follower.poll)

    def diagnosed(self, text: str) -> list[str]:
        return self.after(lambda: self.follower.diagnosed([text]))


@pytest.fixture
def followed() -> Followed:
    return Followed()


X = WireReport(name="x")


@pytest.mark.parametrize(
    ("changed", "lines"),
    [
        ({"lease": LeaseReport(holder="anna", held_s=1.0)}, ["anna drives."]),
        ({"lease": LeaseReport(holder="bert")}, ["bert is handed the lease."]),
        ({"buttons": ButtonsReport(alive=1, required=2)}, ["Stop buttons: 1 alive, 2 required."]),
        ({"calibration": CalibrationReport(fault="it is torn")}, ["Nothing can be started: it is torn"]),
        ({"mode": Mode.ESTOPPED, "estop_source": "bert"}, ["Emergency stop by bert: nothing runs until a reset."]),
        ({"controller": ControllerReport(alive=True, age_ms=3.0), "wire": X}, ["The controller (x) is alive."]),
        ({"controller": ControllerReport(alive=False, age_ms=9.0), "wire": X}, ["The controller (x) is SILENT."]),
        (
            {"power": PowerReport(interface="can0", alive=False, age_ms=3000.0)},
            ["Power (can0): does not answer.", UNCONFIRMED],
        ),
        (
            {"certificate": CertificateReport(file="gateway.pem", expires=WALL + timedelta(days=3))},
            [f"The robot's gateway.pem expires on 2026-01-05, in 2 days; {certs.renewal('gateway')}"],
        ),
    ],
)
def test_each_change_is_a_line_once(followed: Followed, changed: dict[str, object], lines: list[str]) -> None:
    followed.state()
    assert followed.state(changed=changed) == lines
    assert followed.state(changed=changed) == []


def test_no_source_controls_the_terminal(followed: Followed) -> None:
    followed.follower.received_event(rejected("\x1b[2Janna", "a\nb"))
    assert followed.lines[0].plain.endswith(r"command_rejected   \x1b[2Janna: invalid: a\nb")


@pytest.mark.parametrize("how", ["its token goes", "nothing comes"])
def test_a_gateway_that_falls_silent_and_comes_back(followed: Followed, how: str) -> None:
    assert followed.look(SILENT_AFTER_NS) == [], "none was there yet"
    followed.state()
    assert followed.look(SILENT_AFTER_NS) == []
    silent = ["The gateway is SILENT: what the robot does is not known."]
    assert (followed.token(alive=False) if how == "its token goes" else followed.look(1)) == silent
    assert followed.look(SILENT_AFTER_NS) == [], "once"
    assert followed.token(alive=True)[0].startswith("The gateway publishes again, after ")
    assert followed.state() == []


def test_a_gateway_that_was_started_again_is_a_line_and_an_answer_that_was_overtaken_is_none(
    followed: Followed,
) -> None:
    followed.state(state(100.0))
    assert followed.state(state(99.9, Mode.ACTIVE, running={3})) == []
    assert followed.state(state(0.1, started_s=100.0)) == ["The gateway was started again."]


def test_why_nothing_comes_is_said_once_until_something_does(followed: Followed) -> None:
    assert followed.diagnosed("nobody listens there") == ["nobody listens there"]
    assert followed.diagnosed("nobody listens there") == []
    followed.state()
    assert followed.diagnosed("nobody listens there") == [], "it publishes"
    followed.token(alive=False)
    assert followed.diagnosed("nobody listens there") == ["nobody listens there"]


# ---- decode: the line for each frame, what is wrong with others, and the exit codes


STOP_32 = "06 02 20 02 00 00"
LEG_3 = "0e 01 1f 01 5a 00 20 03 2d 19 21 02 00 00"
STOP_32_LINE = f"{STOP_32}: ONE SERVO: servo 32 stop"
LEG_3_LINE = f"{LEG_3}: ONE LEG, leg 3: servo 31 start 90.00°, servo 32 set 45.25°, servo 33 stop"


def decode(*arguments: str) -> tuple[int, list[str]]:
    end = run_here("decode", *arguments)
    assert end.stderr == ""
    return end.returncode, end.stdout.splitlines()


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
    assert run_here("decode").returncode == 2


@given(st.lists(st.text(st.characters(exclude_characters="\0", exclude_categories=())) | st.binary().map(bytes.hex)))
def test_whatever_is_typed_prints_lines_that_any_terminal_takes(typed: list[str]) -> None:
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        code = decode_command.decode(typed)
    lines = printed.getvalue().splitlines()
    assert lines
    assert all(line.isprintable() for line in lines)
    assert code == any(": ONE " not in line for line in lines)
