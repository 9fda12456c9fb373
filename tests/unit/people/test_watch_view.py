"""What `watch` draws: it fits every terminal, and 80 columns and 24 rows hold everything important."""

from datetime import timedelta

import pytest
from rich.cells import cell_len
from rich.text import Text

from gateway.people.tools.watch.model import Confirmation, Model
from gateway.people.tools.watch.view import bar, picture
from schemas.telemetry import Battery, CalibrationReport, ControllerReport, GatewayState, Kind, Mode, Telemetry
from tests.support.measuring import MEASURED
from tests.support.watch_reports import NS_PER_MS, WALL, event, model_with_state, rejected, screen, state


@pytest.mark.parametrize("width", [20, 40, 60, 79, 80, 81, 120, 300])
@pytest.mark.parametrize("height", [1, 2, 5, 10, 12, 23, 24, 25, 60])
def test_it_fills_every_terminal_and_no_more(width: int, height: int) -> None:
    model = Model()
    heard = state(123456, Mode.ESTOPPED, counts=(10**7, 10**7, 10**7), frames=10**8, running=True, age_ms=1e9)
    model.received_state(heard, 0, WALL)
    for number in range(100):
        model.received_event(rejected(f"猫 {number} " + "x" * 56, "a long reason, in many words, " * 5), 0, WALL)
    model.stop.press(0)
    model.stop.unanswered()
    model.ask(Confirmation.RESET, 0)
    lines = screen(model, NS_PER_MS, width, height).split("\n")
    assert len(lines) == height
    assert max(map(cell_len, lines)) <= width
    last = " NOT STOPPED, NO ANSWER" if height == 1 else " SPACE or e: EMERGENCY STOP"
    assert lines[-1].startswith(last[:width])


def test_80_by_24_holds_everything_important() -> None:
    model = Model()
    heard = state(3723, Mode.ACTIVE, counts=(1234, 12, 3), frames=5000, running=True, age_ms=45)
    model.received_state(heard, 0, WALL)
    model.received_event(rejected("anna", "servo 41 does not run"), 0, WALL)
    for text in (
        " ACTIVE ",
        "1 leg running",
        "tcp/robot:7447",
        "up 1:02:03",
        "command / 250 ms",
        " 6  ○",
        "1234",
        "5000",
        "0 SPI errors",
        "anna 1 (invalid)",
        "command_rejected anna: servo 41 does not run",
        "EMERGENCY STOP",
        "r: reset",
        "q: quit",
    ):
        assert text in screen(model), screen(model)


def test_who_commands_each_leg_and_who_stopped_the_robot_is_shown() -> None:
    model = Model()
    heard = state(3723, Mode.ESTOPPED, running=True, age_ms=45)
    first, *others = heard.legs
    legs = (first.model_copy(update={"source": "anna's tripod gait"}), *others)
    model.received_state(heard.model_copy(update={"legs": legs, "estop_source": "ben\x1b[2J"}), 0, WALL)
    lines = screen(model).splitlines()
    assert lines[0].startswith(" ESTOPPED  by ben\\x1b[2J ")
    assert next(line for line in lines if line.startswith("leg ")).endswith("commanded by")
    assert next(line for line in lines if line.startswith(" 1 ")).endswith("  anna's tripod…")


def test_a_calibration_that_cannot_be_used_is_shown() -> None:
    model = Model()
    fault = "/var/lib/hexapod-gateway/calibration.toml: is not TOML:\x1b[2J Invalid statement (at line 1, column 1)"
    model.received_state(
        state().model_copy(update={"calibration": CalibrationReport(revision=3, fault=fault)}), 0, WALL
    )
    shown = " ".join(line.strip() for line in screen(model).splitlines()[1:3])
    assert shown.startswith("Nothing can be started (calibrate accept-default): /var/lib/hexapod-gateway/calibration")
    assert "is not TOML:\\x1b[2J Invalid statemen" in shown


@pytest.mark.parametrize("mode", list(Mode))
def test_each_mode_has_its_word_and_a_style(mode: Mode) -> None:
    model = Model()
    model.received_state(state(mode=mode), 0, WALL)
    text: Text = picture(model, 0, "here", 80, 24)
    assert f" {mode.upper().replace('_', ' ')} " in text.plain.splitlines()[0]
    assert any(span.start == 0 and "on" in str(span.style) for span in text.spans)


@pytest.mark.parametrize(
    ("share", "drawn"),
    [(-1, "────"), (0, "────"), (0.125, "╸───"), (0.5, "━━──"), (1, "━━━━"), (9, "━━━━")],
)
def test_bars(share: float, drawn: str) -> None:
    assert bar(share, 4, "green").plain == drawn


def test_events_are_shown_newest_first_in_local_time() -> None:
    model = model_with_state(Model())
    model.received_event(event(Kind.STARTED, "first"), 0, WALL)
    model.received_event(event(Kind.STOPPING, "second"), 0, WALL + timedelta(seconds=1))
    shown = screen(model).splitlines()
    local = WALL.astimezone()
    assert shown.index(f"{local:%H:%M:%S} stopping         second") < shown.index(
        f"{local:%H:%M:%S} started          first"
    )


ALL = "  7.40 V  80 %  tilt 0°  31.5 °C  controller alive  feet ○1 ●2 ●3 ●4 ●5 ●6"


def of_controller(alive: bool | None, uptime_s: float = 10.0, started_s: float = 0.0) -> GatewayState:
    return state(uptime_s, started_s=started_s).model_copy(
        update={"controller": ControllerReport(protocol="elkapod-2025", alive=alive)}
    )


@pytest.mark.parametrize(
    ("alive", "telemetry", "row"),
    [
        (True, MEASURED, ALL),
        (False, MEASURED, ALL.replace("controller alive", "CONTROLLER SILENT")),
        (None, MEASURED, ALL.replace("  controller alive", "")),
        (True, None, "  controller alive"),
        (False, Telemetry(time=WALL, age_ms=1), "  CONTROLLER SILENT"),
        (None, Telemetry(time=WALL, age_ms=1), None),
        (None, None, None),
    ],
)
def test_what_the_robot_measures_is_one_row_and_none_where_it_measures_nothing(
    alive: bool | None, telemetry: Telemetry | None, row: str | None
) -> None:
    model = Model()
    model.received_state(of_controller(alive), 0, WALL)
    if telemetry is not None:
        model.received_telemetry(telemetry, 0)
    text = picture(model, 0, "here", 80, 24)
    _, _, below = text.plain.partition("\n 6  ")
    _, *rows = [line.rstrip() for line in below.splitlines()]
    measured = rows[: rows.index("")]
    assert measured == ([] if row is None else [row])
    assert rows[len(measured) + 1].split()[:1] == ["accepted"], "behind one blank row"
    red = [str(text.plain[span.start : span.end]) for span in text.spans if "red" in str(span.style)]
    assert ("  CONTROLLER SILENT" in red) is (alive is False)


def test_feet_that_carry_have_another_mark_than_those_that_do_not() -> None:
    model = Model()
    model.received_state(of_controller(True), 0, WALL)
    model.received_telemetry(MEASURED.model_copy(update={"feet": (9.0, 0.0, 0.1, 11.0, 8.0, -0.2)}), 0)
    assert "feet ●9 ○0 ○0.1 ●11 ●8 ○-0.2" in screen(model)


def test_measurements_that_are_old_say_so_and_those_of_another_start_are_gone() -> None:
    model = Model()
    model.received_state(of_controller(True), 0, WALL)
    model.received_telemetry(MEASURED.model_copy(update={"age_ms": 600.0}), 0)
    assert " old  feet" not in screen(model, 400 * NS_PER_MS)
    assert "  1.0 s old  feet" in screen(model, 401 * NS_PER_MS)
    model.received_state(of_controller(True, uptime_s=0.1, started_s=10.4), 500 * NS_PER_MS, WALL)
    assert "feet" not in screen(model, 500 * NS_PER_MS)


def test_without_telemetry_the_states_battery_is_shown() -> None:
    model = Model()
    model.received_state(state().model_copy(update={"battery": Battery(voltage_v=6.123, percent=17.4)}), 0, WALL)
    assert "  6.12 V  17 %\n" in screen(model)
