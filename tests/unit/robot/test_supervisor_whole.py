"""Where only the whole robot starts and stops (elkapod-2025). Each step is judged by the oracle."""

import pytest

from gateway.rate_limit import NS_PER_MS
from tests.support.scenes import play

WHOLE = "rules starts_whole=True\n"
STARTED = "; ".join(f"command {leg} start 90" for leg in range(1, 7))
RUNNING = f"{WHOLE} 10 legs 123456 start 90 (key legs) → {STARTED}; completed 1\n"


@pytest.mark.parametrize("targets", ["servo 11", "leg 1", "legs 12345"])
def test_a_start_of_a_part_is_rejected_and_says_what_to_send(targets: str) -> None:
    steps = play(f"{WHOLE} 10 {targets} start 90 → rejected 1 whole_robot\n due never")
    assert steps.detail == (
        "this robot can only be started as a whole: send one command with a start for each joint of all six legs to "
        "hexapod/legs/cmd"
    )


@pytest.mark.parametrize("targets", ["servo 42", "leg 4", "legs 25", "legs 123456"])
def test_a_stop_of_any_servo_stops_all_six_legs(targets: str) -> None:
    play(f"""{RUNNING}
        20 {targets} stop → command 1-6 stop; completed 2
        running none
        30 servo 42 set 80 → rejected 3 servo_stopped""")


@pytest.mark.parametrize("other", ["start 80", "set 80"])
def test_a_command_that_stops_and_moves_stops_and_its_moves_are_dropped(other: str) -> None:
    play(f"""{RUNNING}
        40 leg 1 stop | {other} | {other} → command 1-6 stop; rejected 2 whole_robot stopped
        says this robot only stops as a whole: a Stop in this command stopped it, and its moves are dropped
        due never""")


def test_a_start_waits_for_the_last_legs_rate_slot_and_then_leaves_in_one_step() -> None:
    steps = play(f"""{RUNNING}
        16 leg 4 set 80
        22 leg 4 set 70
        23 leg 1 stop
        24 legs 123456 start 90 (key legs) → nothing""")
    due_ms = steps.due_ms
    assert due_ms == steps.supervisor.legs.by_number[4].slots.next_ns / NS_PER_MS - 60_000
    assert due_ms > 24
    steps.play(f"{due_ms - 0.1} time → nothing\n {due_ms} time → {STARTED}; completed 5")


def test_one_silent_leg_stops_the_robot_whatever_the_scope_and_the_event_says_why() -> None:
    play(f"""{RUNNING.replace("rules", "rules whole_robot=False,")}
        100 leg 1 set 80
        100 legs 2345 set 80
        260 time → watchdog 1-6 stop; announce watchdog_expired
        legs 123456
        mentions leg 6 in 250 ms; all six legs are stopped, since this robot can only be stopped as a whole
        watchdogs expired expired expired expired expired expired""")
