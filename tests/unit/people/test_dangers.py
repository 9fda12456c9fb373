"""What means danger: a Stop that the power board does not confirm, and events."""

import re
from pathlib import Path
from typing import cast

import pytest

from gateway.errors import UnansweredError
from gateway.people.client.dangers import (
    PATIENCE_NS,
    SHOWN_NS,
    UNCONFIRMED,
    PowerAlarm,
    StopStatus,
    confirmed_off,
    power_now,
    tone_of,
)
from gateway.people.client.stopped import ALL_STOPPED
from gateway.people.commands.send import command_report, estop_report
from gateway.people.console.pages.pages import Page, Pages
from schemas.telemetry import Ack, GatewayState, Kind, Mode, PowerReport
from tests.support.published import event, state
from tests.unit.people.test_console_pages import OpenPage

MS = 1_000_000
STOPPED = Ack(accepted=True, stop_frames=6, latency_us=812.4, estop=5)
OFF = PowerReport(interface="slcan", alive=True, confirmed=True, age_ms=4.0)
FED = OFF.model_copy(update={"supplied": tuple(range(18))})
DOUBTED = FED.model_copy(update={"confirmed": False})
SILENT = DOUBTED.model_copy(update={"alive": False, "age_ms": 450.0})
STANDS_BY = PowerReport(interface="slcan", alive=False)


def of(power: PowerReport | None, mode: Mode = Mode.ACTIVE) -> GatewayState:
    return state(mode=mode).model_copy(update={"power": power})


def alarm_after(*found: tuple[int, PowerReport | None], mode: Mode = Mode.ACTIVE) -> str:
    alarm = PowerAlarm()
    for at_ns, power in found:
        alarm.received_state(of(power, mode), at_ns)
    return alarm.sentence


def test_a_state_while_the_board_answers_is_no_alarm_but_two_without_a_confirmation_are() -> None:
    assert alarm_after((0, DOUBTED)) == ""
    assert alarm_after((0, DOUBTED), (PATIENCE_NS - 1, DOUBTED)) == ""
    assert alarm_after((0, DOUBTED), (100 * MS, OFF), (PATIENCE_NS, DOUBTED)) == "", "each cut has its own time"
    assert alarm_after((0, DOUBTED), (PATIENCE_NS, DOUBTED)) == UNCONFIRMED


def test_a_board_that_never_answered_is_an_alarm_in_an_emergency_stop_alone() -> None:
    assert alarm_after((0, STANDS_BY), (10 * PATIENCE_NS, STANDS_BY)) == ""
    assert alarm_after((0, STANDS_BY), mode=Mode.ESTOPPED) == UNCONFIRMED


@pytest.mark.parametrize(
    ("power", "words"),
    [
        (None, ""),
        (OFF, "confirmed off"),
        (FED, "18 fed"),
        (DOUBTED, "off not confirmed, 18 fed"),
        (DOUBTED.model_copy(update={"supplied": ()}), "off not confirmed"),
        (SILENT, "does not answer"),
    ],
)
def test_the_board_in_words(power: PowerReport | None, words: str) -> None:
    assert power_now(power) == words


def test_every_event_that_stops_all_legs_and_every_doubt_is_bad() -> None:
    for kind in (*ALL_STOPPED, Kind.POWER_UNCONFIRMED, Kind.SERVO_DRAWS):
        assert tone_of(kind) == "bad", kind
    assert tone_of(Kind.SERVO_SILENT) == "warn"
    assert tone_of(Kind.POWER_RESTORED) == tone_of("of a later gateway") == "plain"


# ---- where people see it


def test_a_terminal_is_red_until_the_board_confirms_a_stop() -> None:
    stop = StopStatus()
    stop.press(0)
    stop.confirm(STOPPED.model_copy(update={"confirmed": False}), None, 150 * MS)
    assert stop.remark(10 * SHOWN_NS) == (UNCONFIRMED, True, 0)
    stop.power.received_state(of(OFF, Mode.ESTOPPED), 200 * MS)
    remark = stop.remark(200 * MS)
    assert remark is not None
    assert not remark.is_bad


@pytest.mark.parametrize(
    ("confirmed", "confirmed_ms", "power", "code", "words"),
    [
        (None, None, None, 0, "of the request\n"),
        (True, 34.2, OFF, 0, "of the request, power confirmed off after 34 ms\n"),
        (False, None, DOUBTED, 1, f"of the request\n{UNCONFIRMED}\n"),
        (False, None, SILENT, 1, f"of the request\n{UNCONFIRMED}\n"),
        (False, None, UnansweredError("no state"), 1, f"of the request\n{UNCONFIRMED}\n"),
        (False, None, FED, 0, "of the request\n"),  # nothing is to be off: this Stop leaves the supply on
    ],
)
def test_the_command_says_whether_the_board_confirmed(
    capsys: pytest.CaptureFixture[str],
    confirmed: bool | None,
    confirmed_ms: float | None,
    power: PowerReport | UnansweredError | None,
    code: int,
    words: str,
) -> None:
    def look() -> GatewayState:
        if isinstance(power, UnansweredError):
            raise power
        return of(power, Mode.ESTOPPED)

    ack = STOPPED.model_copy(update={"confirmed": confirmed, "confirmed_ms": confirmed_ms})
    assert estop_report(ack, look) == code
    assert capsys.readouterr().out == f"stopped: 6 Stop frames written within 812 µs {words}"
    assert command_report(ack, "accepted of the request", look) == code
    assert capsys.readouterr().out == f"accepted {words}", "a Stop of single legs, too"
    assert confirmed_off(Ack(accepted=True, confirmed=True)) == ", power confirmed off"


async def test_a_page_gets_the_sentence_with_the_state_and_at_once_with_the_event() -> None:
    pages, page = Pages("", lambda: 0), OpenPage()
    pages.add(cast("Page", page))

    async def newest() -> dict[str, str]:
        text = [each for each in await page.outgoing.wait() if '"type":"state"' in each][-1]
        return dict(re.findall(r'"(power|unconfirmed)": "([^"]*)"', text))

    pages.received_state(of(FED), 0)
    assert await newest() == {"power": "18 fed", "unconfirmed": ""}
    pages.received_event(event(Kind.POWER_UNCONFIRMED))
    assert await newest() == {"power": "18 fed", "unconfirmed": UNCONFIRMED}
    pages.received_state(of(OFF), 1)
    assert await newest() == {"power": "confirmed off", "unconfirmed": ""}


def test_the_sentence_stands_in_one_place() -> None:
    """No surface decides for itself what is not confirmed."""
    people = Path(__file__).parents[3] / "gateway" / "people"
    files = [each for each in people.rglob("*") if each.suffix in (".py", ".js", ".html")]
    assert [each.name for each in files if UNCONFIRMED in each.read_text()] == ["dangers.py"]
