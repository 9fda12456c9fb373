"""Who watches: each rule of the stop buttons, judged by the oracle as well."""

from typing import Final

import pytest

from gateway.rate_limit import NS_PER_MS
from gateway.robot.core.buttons import MOST_OF_ONE, MOST_UNPROVED
from gateway.robot.core.events import ButtonRequest, RequestAnswer
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import Supervisor
from schemas.words import Reason
from tests.support.scenes import Scenes, all_stopped, play, scene_test

TIMEOUT_MS = 1000
KITCHEN = "k" * 32
RULES = Rules(repeats=0, rest_runs=0, buttons_required=1, buttons_timeout_ns=TIMEOUT_MS * NS_PER_MS)
SLOW: Final = "rules timeout_ms=10000, rest_ms=10000, "
"""The watchdog is slower than the buttons, so that it is not what stops the legs."""
REQUIRED: Final = SLOW + "buttons_required=1\n"
TWO: Final = SLOW + "buttons_required=2\n"
KITCHEN_ALIVE: Final = """
    0 button register kitchen → announce button_registered; granted
    0 button alive kitchen 1 → granted
"""
RUNS: Final = KITCHEN_ALIVE + "1 leg 1 start 90 → command 1 start 90; completed 1\n"
"""The kitchen is alive since 0 ms, and leg 1 runs."""
WATCHED: Final = REQUIRED + RUNS
LANDING: Final = SLOW + "buttons_required=1, landing_ms=400, landing_cdeg={11: 3000}\n" + RUNS


def test_all_six_legs_stop_when_the_last_one_that_counts_falls_silent() -> None:
    robot = play(f"""{WATCHED}
        due 1000
        999 time → nothing
        1000 time → watchdog 1-6 stop; announce button_silent
        source kitchen
        legs 123456""")
    told = robot.announced[0]
    assert told.key is None, "nobody asked for it"
    assert told.detail == (
        "no check-in of the button kitchen in 1000 ms; 0 of the 1 buttons that are required are alive; "
        "all six legs are stopped"
    )
    assert (robot.running, robot.due_ms, robot.supervisor.buttons.names) == ([], None, ())


def test_a_button_that_returns_starts_nothing_and_lets_start() -> None:
    robot = play(f"""{WATCHED}
        1000 time
        5000 button alive kitchen 2 → announce button_returned; granted
        running none""")
    assert robot.supervisor.buttons.down is None
    robot.play("5001 leg 1 start 90 → command 1 start 90; completed 2")


SCENES: Final = {
    "nothing starts before a button is alive": f"""{REQUIRED}
        1 leg 1 start 90 → rejected 1 no_button
        2 button register kitchen
        3 leg 1 start 90 → rejected 2 no_button  # who is registered has not checked in yet
        4 button alive kitchen 0
        5 leg 1 start 90 → command 1 start 90; completed 3""",
    "a stop needs no button and a reset does": f"""{REQUIRED}
        1 leg 1 stop → command 1 stop; completed 1
        2 estop → estop 1-6 stop; …
        3 reset → rejected 2 no_button
        4 button register kitchen
        4 button alive kitchen 1
        5 reset → announce estop_reset; completed 3""",
    "a landing that would begin after its end is a stop": f"""{LANDING}
        1400 time → watchdog 1-6 stop; …""",
    "leaving on purpose stops as silence does": f"""{WATCHED}
        10 button leave kitchen → watchdog 1-6 stop; announce button_left; granted
        11 leg 1 start 90 → rejected 2 no_button
        12 button alive kitchen 2 → unknown_button""",
    "one that is older than the timeout is rejected": f"""{REQUIRED}
        10 button register kitchen (sent 8)
        22 button alive kitchen 1 (sent 20)
        1022 time
        3000 button alive kitchen 2 (sent 1500) → stale
        answers the check-in is 1497 ms old; it counts for 1000 ms
        3001 button alive kitchen 3 (sent 2999) → announce button_returned; granted""",
    "a check-in that was recorded and is sent again counts for nothing": f"""{WATCHED}
        900 button alive kitchen 1 → stale
        900 button alive kitchen 0 → stale
        1000 time → watchdog 1-6 stop; …""",
    "where none is required buttons come and go and stop nothing": f"""{SLOW} buttons_required=0
        1 leg 1 start 90
        1 button register kitchen
        1 button alive kitchen 1
        1001 time → announce button_silent
        legs
        running 11 12 13""",
}
test_a_scene = scene_test(SCENES)


def test_a_name_registers_once_and_the_newer_registration_is_alive_for_as_long_as_the_older_was() -> None:
    robot = play(WATCHED)
    robot.supervisor.buttons._by_token["the first"] = robot.supervisor.buttons._by_token.pop("kitchen")
    robot.oracle.buttons.known["the first"] = robot.oracle.buttons.known.pop("kitchen")
    robot.play("""
        10 button register kitchen → announce button_registered; granted
        mentions kitchen is registered as a button, and replaces the earlier one of this name
        running 11 12 13
        due 1000  # registering is no check-in""")
    assert robot.button(11, "alive", "the first", 2) == ["unknown_button"]
    robot.play("12 button alive kitchen 0 → granted\n due 1012")


# ---- whose places they are


def test_a_name_that_another_certificate_registers_takes_no_place() -> None:
    robot = Scenes(Rules(buttons_required=2))
    for holder in ("anna's", "the rogue's"):
        robot.play(f"""
            0 button register kitchen (holder {holder}) → announce button_registered; granted
            0 button alive kitchen 1 (holder {holder}) → granted""")
        assert "replaces" not in str(robot.announced)
    robot.play("1 leg 1 start 90 → command 1 start 90; completed 1")


def test_two_names_of_one_certificate_are_not_the_two_that_are_required() -> None:
    play(f"""{TWO}
        1 leg 1 start 90 → rejected 1 no_button
        2 button register rogue/0 (holder the rogue's)
        2 button alive rogue/0 1 (holder the rogue's) → granted
        2 button register rogue/1 (holder the rogue's) → announce button_registered; granted
        2 button alive rogue/1 1 (holder the rogue's) → granted
        3 leg 1 start 90 → rejected 2 no_button
        mentions 1 of the 2 buttons that are required is alive
        4 button register anna (holder anna's)
        4 button alive anna 1 (holder anna's) → granted
        5 leg 1 start 90 → command 1 start 90; …""")


def test_a_certificate_has_four_places_and_gives_its_own_silent_ones_away() -> None:
    robot = play(REQUIRED)
    robot.button(0, "register", "kitchen", holder="the kitchen's")
    for number in range(10):
        assert robot.button(0, "register", f"rogue {number}", holder="the rogue's") == [
            "announce button_registered",
            "granted",
        ]
    known = [button.name for button in robot.supervisor.buttons._by_token.values()]
    assert known == ["kitchen", *(f"rogue {number}" for number in range(10 - MOST_OF_ONE, 10))]
    for number in range(6, 10):
        robot.button(1, "alive", f"rogue {number}", 1, holder="the rogue's")
    assert robot.button(2, "register", "rogue 10", holder="the rogue's") == ["button_denied"]
    assert robot.only(RequestAnswer).detail == "4 buttons of this certificate are alive, and no more can register"
    assert robot.button(3, "alive", "kitchen", 1, holder="the kitchen's") == ["granted"]
    assert robot.button(4, "register", "hall", holder="the hall's") == ["announce button_registered", "granted"]


def test_a_button_that_is_not_wanted_checks_in_and_does_not_count() -> None:
    robot = play(WATCHED)
    robot.button(1, "register", "stranger", counts=False)
    assert robot.only(RequestAnswer).detail.endswith("does not count towards those required (buttons.names)")
    assert robot.button(2, "alive", "stranger", 1) == ["granted"]
    assert robot.only(RequestAnswer).detail.endswith("does not count towards those required (buttons.names)")
    assert robot.supervisor.buttons.alive == 1
    assert robot.time(TIMEOUT_MS)[:6] == all_stopped("watchdog")


def test_where_all_places_are_alive_no_more_are_taken() -> None:
    robot = play(REQUIRED)
    for number in range(MOST_UNPROVED):
        robot.button(0, "register", f"button {number}")
        robot.button(0, "alive", f"button {number}", 1)
    assert robot.button(1, "register", "one more") == ["button_denied"]
    robot.time(TIMEOUT_MS)
    assert robot.button(1001, "register", "one more") == ["announce button_registered", "granted"]


def test_a_check_in_that_was_held_back_counts_no_longer_than_its_age() -> None:
    """The button's clock is 5 s behind the gateway's, and its messages take 2 ms: the gateway knows neither."""
    robot = play(REQUIRED)
    robot.button(10, "register", "kitchen", sent_ms=55_008)
    robot.button(22, "alive", "kitchen", 1, sent_ms=55_020)
    assert robot.due_ms == 22 + TIMEOUT_MS
    robot.button(600, "alive", "kitchen", 2, sent_ms=55_098)
    assert robot.due_ms == pytest.approx(100 + TIMEOUT_MS, abs=0.2), "it came 500 ms late; clocks may drift by 200 ppm"


def test_a_check_in_that_waited_for_the_whole_timeout_is_rejected() -> None:
    robot = Supervisor(RULES)
    found = robot.buttons
    found.take(ButtonRequest("register", 0, "kitchen", fresh_token=KITCHEN), 0)
    check_in = ButtonRequest("alive", 5, token=KITCHEN, count=1)
    (answer,) = found.take(check_in, 5 + TIMEOUT_MS * NS_PER_MS)
    assert isinstance(answer, RequestAnswer)
    assert answer.reason is Reason.STALE
    assert found.alive == 0


def offset_of(rise_ms: list[tuple[float, float]]) -> float:
    """Return how late a button's last message counts as sent, in ms. Its messages: when (s), delay (ms)."""
    robot, at_ms = Scenes(RULES), 0.0
    for number, (at_s, delay_ms) in enumerate(rise_ms):
        at_ms = at_s * 1000
        do = "alive" if number else "register"
        assert robot.button(at_ms, do, "kitchen", number, sent_ms=at_ms - delay_ms)[-1] == "granted"
    assert robot.due_ms is not None
    return TIMEOUT_MS - (robot.due_ms - at_ms)


def test_how_far_a_clock_may_fall_behind_counts_from_its_fastest_message() -> None:
    assert offset_of([(0, 0), (10, -100), (2010, 300)]) == 150
    assert offset_of([(0, 0), (10, 50), (2010, 400)]) == 150


def test_check_ins_that_are_held_back_ever_longer_are_old() -> None:
    """0.19 ms more each second is less than a slow clock may lose, and was 6.8 s after ten hours."""
    robot = Supervisor(RULES)
    buttons = robot.buttons
    token = "0" * 32
    buttons.take(ButtonRequest("register", 0, "kitchen", sent_ms=0, fresh_token=token), 0)
    counts_ms = 0.0
    for second in range(1, 10 * 3600):
        sent_ms, held_back_ms = second * 1000, 0.19 * second
        came_ns = round((sent_ms + held_back_ms) * NS_PER_MS)
        buttons.expire(came_ns)
        check_in = ButtonRequest("alive", came_ns, token=token, count=second, sent_ms=sent_ms)
        buttons.take(check_in, came_ns)
        if buttons.due_ns is not None:
            counts_ms = max(counts_ms, buttons.due_ns / NS_PER_MS - sent_ms)
    assert counts_ms <= 1.25 * TIMEOUT_MS + 1
