"""Who watches: each rule of the stop buttons, judged by the oracle as well."""

import pytest

from gateway.allowance import NS_PER_MS
from gateway.robot.core.buttons import MOST_OF_ONE, MOST_UNPROVED, Buttons
from gateway.robot.core.events import ButtonDo, ButtonRequest, RequestAnswer
from gateway.robot.core.leg import Rules
from gateway.robot.core.supervisor import Supervisor
from schemas.telemetry import Reason
from tests.support.steps import Steps, all_stopped, leg_to

TIMEOUT_MS = 1000
KITCHEN = "k" * 32
START, SET, STOP = leg_to(1, "start 90"), leg_to(1, "set 45"), leg_to(1, "stop")
REGISTERED = ["announce button_registered", "granted"]
ALIVE = ["granted"]
REFUSED = "rejected 1 no_button"


def rules(required: int = 1, landing_ms: int = 0) -> Rules:
    """The watchdog is slower than the buttons, so that it is not what stops the legs."""
    return Rules(
        repeats=0,
        rest_runs=0,
        rest_ns=10_000 * NS_PER_MS,
        timeout_ns=10_000 * NS_PER_MS,
        buttons_required=required,
        landing_ns=landing_ms * NS_PER_MS,
        landing_cdeg={11: 30_00},
    )


def watched(required: int = 1, landing_ms: int = 0) -> Steps:
    """The kitchen is alive since 0 ms, and leg 1 runs."""
    robot = Steps(rules(required, landing_ms))
    assert robot.button(0, "register", "kitchen") == REGISTERED
    assert robot.button(0, "alive", "kitchen", 1) == ALIVE
    if required == 1:
        assert robot.command(1, START) == ["command 1 start 90", "completed 1"]
    return robot


# ---- fewer than required


def test_nothing_starts_before_a_button_is_alive() -> None:
    robot = Steps(rules())
    assert robot.command(1, START) == [REFUSED]
    robot.button(2, "register", "kitchen")
    assert robot.command(3, START) == ["rejected 2 no_button"], "who is registered has not checked in yet"
    robot.button(4, "alive", "kitchen", 0)
    assert robot.command(5, START) == ["command 1 start 90", "completed 3"]


def test_a_stop_needs_no_button_and_a_reset_does() -> None:
    robot = Steps(rules())
    assert robot.command(1, STOP) == ["command 1 stop", "completed 1"]
    assert robot.estop(2)[:6] == all_stopped("estop")
    assert robot.reset(3) == ["rejected 2 no_button"]
    robot.button(4, "register", "kitchen")
    robot.button(4, "alive", "kitchen", 1)
    assert robot.reset(5) == ["announce estop_reset", "completed 3"]


def test_the_rejection_names_how_many_are_missing() -> None:
    robot = watched(required=3)
    found = robot.supervisor.buttons
    assert found._too_few()[1].startswith("1 of the 3 buttons that are required is alive")
    robot.button(1, "register", "hall")
    robot.button(1, "alive", "hall", 0)
    assert found._too_few()[1].startswith("2 of the 3 buttons that are required are alive")


def test_where_none_is_required_buttons_come_and_go_and_stop_nothing() -> None:
    robot = Steps(rules(required=0))
    robot.command(1, START)
    robot.button(0, "register", "kitchen")
    robot.button(0, "alive", "kitchen", 1)
    assert robot.time(TIMEOUT_MS) == ["announce button_silent"]
    assert robot.announced[0].legs == ()
    assert robot.running


# ---- silence


def test_all_six_legs_stop_when_the_last_one_that_counts_falls_silent() -> None:
    robot = watched()
    assert robot.due_ms == TIMEOUT_MS
    assert robot.time(TIMEOUT_MS - 1) == []
    assert robot.time(TIMEOUT_MS) == [*all_stopped("watchdog"), "announce button_silent"]
    told = robot.announced[0]
    assert (told.source, told.key, told.legs) == ("kitchen", None, (1, 2, 3, 4, 5, 6)), "nobody asked for it"
    assert told.detail == (
        "no check-in of the button kitchen in 1000 ms; 0 of the 1 buttons that are required are alive; "
        "all six legs are stopped"
    )
    assert robot.running == []
    assert robot.due_ms is None
    assert robot.supervisor.buttons.names == ()


def test_a_button_that_returns_starts_nothing_and_lets_start() -> None:
    robot = watched()
    robot.time(TIMEOUT_MS)
    assert robot.button(5000, "alive", "kitchen", 2) == ["announce button_returned", "granted"]
    assert robot.running == []
    assert robot.supervisor.buttons.fell_ns is None
    assert robot.command(5001, START) == ["command 1 start 90", "completed 2"]


# ---- landing


def test_where_a_landing_is_configured_it_begins_and_ends_in_time() -> None:
    robot = watched(landing_ms=400)
    assert robot.time(TIMEOUT_MS) == ["announce button_silent", "announce landing"]
    assert robot.announced[0].detail.endswith("the robot lands")
    assert robot.command(1100, SET) == ["rejected 2 landing", "watchdog 11 set 86.66"]
    robot.button(1200, "alive", "kitchen", 2)
    took = robot.time(1400)
    assert took == [*all_stopped("watchdog"), "announce watchdog_expired"], "who is back makes it no longer"


def test_a_landing_that_would_begin_after_its_end_is_a_stop() -> None:
    robot = watched(landing_ms=400)
    assert robot.time(TIMEOUT_MS + 400)[:6] == all_stopped("watchdog")


# ---- leaving, and registering anew


def test_leaving_on_purpose_stops_as_silence_does() -> None:
    robot = watched()
    took = robot.button(10, "leave", "kitchen")
    assert took == [*all_stopped("watchdog"), "announce button_left", "granted"]
    assert robot.command(11, START) == ["rejected 2 no_button"]
    assert robot.button(12, "alive", "kitchen", 2) == ["unknown_button"]


def test_a_name_registers_once_and_the_newer_registration_is_alive_for_as_long_as_the_older_was() -> None:
    robot = watched()
    robot.supervisor.buttons._by_token["the first"] = robot.supervisor.buttons._by_token.pop("kitchen")
    robot.oracle.buttons.known["the first"] = robot.oracle.buttons.known.pop("kitchen")
    assert robot.button(10, "register", "kitchen") == REGISTERED
    assert robot.announced[0].detail.startswith(
        "kitchen is registered as a button, and replaces the earlier one of this name"
    )
    assert robot.running
    assert robot.due_ms == TIMEOUT_MS, "registering is no check-in"
    assert robot.button(11, "alive", "the first", 2) == ["unknown_button"]
    assert robot.button(12, "alive", "kitchen", 0) == ALIVE
    assert robot.due_ms == 12 + TIMEOUT_MS


# ---- whose places they are


def test_a_name_that_another_certificate_registers_takes_no_place() -> None:
    robot = Steps(rules(required=2))
    for holder in ("anna's", "the rogue's"):
        assert robot.button(0, "register", "kitchen", holder=holder) == REGISTERED
        assert not robot.announced[0].detail.count("in place of")
        assert robot.button(0, "alive", "kitchen", 1, holder=holder) == ALIVE
    assert robot.command(1, START) == ["command 1 start 90", "completed 1"]


def test_a_certificate_has_four_places_and_gives_its_own_silent_ones_away() -> None:
    robot = Steps(rules())
    robot.button(0, "register", "kitchen", holder="the kitchen's")
    for number in range(10):
        assert robot.button(0, "register", f"rogue {number}", holder="the rogue's") == REGISTERED
    known = [button.name for button in robot.supervisor.buttons._by_token.values()]
    assert known == ["kitchen", *(f"rogue {number}" for number in range(10 - MOST_OF_ONE, 10))]
    for number in range(6, 10):
        robot.button(1, "alive", f"rogue {number}", 1, holder="the rogue's")
    assert robot.button(2, "register", "rogue 10", holder="the rogue's") == ["button_denied"]
    assert robot.only(RequestAnswer).detail == "4 buttons of this certificate are alive, and no more can register"
    assert robot.button(3, "alive", "kitchen", 1, holder="the kitchen's") == ALIVE
    assert robot.button(4, "register", "hall", holder="the hall's") == REGISTERED


def test_two_names_of_one_certificate_are_not_the_two_that_are_required() -> None:
    robot = Steps(rules(required=2))
    for name, holder in (("rogue/0", "the rogue's"), ("rogue/1", "the rogue's"), ("anna", "anna's")):
        assert robot.command(1, START)[-1].endswith("no_button")
        assert robot.button(2, "register", name, holder=holder) == REGISTERED
        assert robot.button(2, "alive", name, 1, holder=holder) == ALIVE
    assert robot.command(3, START)[0] == "command 1 start 90"


def test_one_that_is_not_wanted_checks_in_and_does_not_count() -> None:
    robot = watched()
    robot.button(1, "register", "stranger", counts=False)
    assert robot.only(RequestAnswer).detail.endswith("does not count towards those required (buttons.names)")
    assert robot.button(2, "alive", "stranger", 1) == ALIVE
    assert robot.only(RequestAnswer).detail.endswith("does not count towards those required (buttons.names)")
    assert robot.supervisor.buttons.alive == 1
    assert robot.time(TIMEOUT_MS)[:6] == all_stopped("watchdog")


def test_where_all_places_are_alive_no_more_are_taken() -> None:
    robot = Steps(rules())
    for number in range(MOST_UNPROVED):
        robot.button(0, "register", f"button {number}")
        robot.button(0, "alive", f"button {number}", 1)
    assert robot.button(1, "register", "one more") == ["button_denied"]
    robot.time(TIMEOUT_MS)
    assert robot.button(1001, "register", "one more") == REGISTERED


# ---- what a check-in is worth


@pytest.mark.parametrize("count", [1, 0])
def test_a_check_in_that_was_recorded_and_is_sent_again_counts_for_nothing(count: int) -> None:
    robot = watched()
    assert robot.button(900, "alive", "kitchen", count) == ["stale"]
    assert robot.time(TIMEOUT_MS)[:6] == all_stopped("watchdog")


def test_a_check_in_that_was_held_back_counts_no_longer_than_its_age() -> None:
    """The button's clock is 5 s behind the gateway's, and its messages take 2 ms: the gateway knows neither."""
    robot = Steps(rules())
    robot.button(10, "register", "kitchen", sent_ms=55_008)
    robot.button(22, "alive", "kitchen", 1, sent_ms=55_020)
    assert robot.due_ms == 22 + TIMEOUT_MS
    robot.button(600, "alive", "kitchen", 2, sent_ms=55_098)
    assert robot.due_ms == pytest.approx(100 + TIMEOUT_MS, abs=0.2), "it came 500 ms late; clocks may drift by 200 ppm"


def test_one_that_is_older_than_the_timeout_is_rejected() -> None:
    robot = Steps(rules())
    robot.button(10, "register", "kitchen", sent_ms=8)
    robot.button(22, "alive", "kitchen", 1, sent_ms=20)
    robot.time(1022)
    assert robot.button(3000, "alive", "kitchen", 2, sent_ms=1500) == ["stale"]
    assert robot.only(RequestAnswer).detail == "the check-in is 1497 ms old; it counts for 1000 ms"
    assert robot.button(3001, "alive", "kitchen", 3, sent_ms=2999) == ["announce button_returned", *ALIVE]


def test_one_that_waited_for_the_whole_timeout_is_rejected() -> None:
    found, legs = Buttons(rules()), Supervisor(rules()).legs
    found.take(ButtonRequest(ButtonDo.REGISTER, 0, "kitchen", fresh_token=KITCHEN), 0, legs)
    check_in = ButtonRequest(ButtonDo.ALIVE, 5, token=KITCHEN, count=1)
    (answer,) = found.take(check_in, 5 + TIMEOUT_MS * NS_PER_MS, legs)
    assert isinstance(answer, RequestAnswer)
    assert answer.reason is Reason.STALE
    assert found.alive == 0


def test_the_first_check_in_is_judged_by_the_registration() -> None:
    """Else one that was held back behind the answer to the registration would count from its arrival."""
    robot = Steps(rules())
    robot.button(10, "register", "kitchen", sent_ms=8)
    assert robot.button(2000, "alive", "kitchen", 1, sent_ms=20) == ["stale"]


def test_a_clock_that_jumps_makes_a_button_silent_and_never_longer_alive() -> None:
    robot = Steps(rules())
    robot.button(10, "register", "kitchen", sent_ms=10)
    robot.button(100, "alive", "kitchen", 1, sent_ms=900_000)
    assert robot.due_ms == 100 + TIMEOUT_MS, "not 900 s ahead"
    assert robot.button(200, "alive", "kitchen", 2, sent_ms=200) == ["stale"], "it jumped back"
    robot.time(1100)
    assert robot.button(1200, "register", "kitchen", sent_ms=1200) == REGISTERED
    assert robot.button(1201, "alive", "kitchen", 1, sent_ms=1201) == ALIVE, "registering anew helps"


# ---- the end, and a new start


def test_at_the_end_requests_are_rejected() -> None:
    robot = watched()
    robot.end(10)
    assert robot.button(11, "alive", "kitchen", 2) == ["stopping"]


def offset_of(rise_ms: list[tuple[float, float]]) -> float:
    """How late a button's last message counts as sent, in ms: its messages come at (s) with so much delay (ms)."""
    rules = Rules(buttons_required=1, buttons_timeout_ns=TIMEOUT_MS * NS_PER_MS)
    buttons, legs = Buttons(rules), Supervisor(rules).legs
    for number, (at_s, delay_ms) in enumerate(rise_ms):
        received_ns = round(at_s * 1e9)
        do = ButtonDo.ALIVE if number else ButtonDo.REGISTER
        request = ButtonRequest(
            do,
            received_ns,
            source="kitchen",
            token=KITCHEN,
            fresh_token=KITCHEN,
            count=number,
            sent_ms=at_s * 1000 - delay_ms,
        )
        answer = buttons.take(request, received_ns, legs)[-1]
        assert isinstance(answer, RequestAnswer)
        assert answer.reason is None
        if number:
            buttons.expire(received_ns, legs)
    assert buttons.due_ns is not None
    return TIMEOUT_MS - (buttons.due_ns - round(rise_ms[-1][0] * 1e9)) / NS_PER_MS


def test_how_far_a_clock_may_fall_behind_counts_from_its_fastest_message() -> None:
    assert offset_of([(0, 0), (10, -100), (2010, 300)]) == 150
    assert offset_of([(0, 0), (10, 50), (2010, 400)]) == 150


@pytest.mark.parametrize("hours", [1, 10])
def test_check_ins_that_are_held_back_ever_longer_are_old(hours: int) -> None:
    """0.19 ms more each second is less than a slow clock may lose, and was 6.8 s after ten hours."""
    rules = Rules(buttons_required=1, buttons_timeout_ns=TIMEOUT_MS * NS_PER_MS)
    buttons, legs = Buttons(rules), Supervisor(rules).legs
    token = "0" * 32
    buttons.take(ButtonRequest(ButtonDo.REGISTER, 0, "kitchen", sent_ms=0, fresh_token=token), 0, legs)
    counts_ms = 0.0
    for second in range(1, hours * 3600):
        sent_ms, held_back_ms = second * 1000, 0.19 * second
        came_ns = round((sent_ms + held_back_ms) * NS_PER_MS)
        buttons.expire(came_ns, legs)
        check_in = ButtonRequest(ButtonDo.ALIVE, came_ns, token=token, count=second, sent_ms=sent_ms)
        buttons.take(check_in, came_ns, legs)
        if buttons.due_ns is not None:
            counts_ms = max(counts_ms, buttons.due_ns / NS_PER_MS - sent_ms)
    assert counts_ms <= 1.25 * TIMEOUT_MS + 1
