"""Commands: accepted as a whole or not at all, and when frames go out. Faults of the bus, staggered starts, the end."""

from dataclasses import replace
from typing import Final

import pytest

from gateway.rate_limit import NS_PER_MS, NS_PER_S
from gateway.robot.core import events
from gateway.robot.core.supervisor import IllegalEvent
from schemas.robot import SERVO_IDS
from schemas.words import Mode
from tests.support.model_check import copied, key, pending
from tests.support.scenes import play, scene_test
from tests.support.small_robots import targets_of
from tests.support.transitions import TRANSITIONS


@pytest.mark.parametrize("servo_id", SERVO_IDS)
def test_a_set_is_rejected_where_nothing_was_started(servo_id: int) -> None:
    play(f"1 servo {servo_id} set 90 → rejected 1 servo_stopped\n running none")


@pytest.mark.parametrize(
    "stop",
    ["30 leg 1 stop", "251 time", "30 estop\n 31 reset", "30 fail\n 50 open"],
    ids=["command", "watchdog", "emergency stop", "fault"],
)
def test_a_set_is_rejected_after_every_kind_of_stop(stop: str) -> None:
    play(f"""
        1 leg 1 start 90
        {stop}
        300 leg 1 set 90 → …; rejected {3 if "leg" in stop or "reset" in stop else 2} servo_stopped
        310 leg 1 start 90 → command 1 start 90; …""")


SCENES: Final = {
    "a pending start of a running servo stays a start": """
        10 leg 1 start 90
        15 leg 1 start 80
        20 leg 1 start 70
        21 leg 1 start 60 → nothing
        22 leg 1 set 50 → completed 4 coalesced
        40 time → command 1 start 50; completed 5""",
    "a leg is shown as expired until it is started or stopped as a whole": """
        1000 leg 1 start 90
        1300 servo 12 stop
        watchdogs expired idle idle idle idle idle  # one servo says nothing of the leg
        1310 leg 1 stop
        watchdogs idle idle idle idle idle idle
        1320 leg 1 start 90
        1600 time
        1610 leg 1 start 90
        watchdogs armed idle idle idle idle idle""",
    "who moves a leg that somebody else has moved is announced and a nameless stop is not": """
        1 leg 1 start 90 (source anna)
        100 leg 1 set 80 (source bert) → …; announce source_changed
        announces leg 1 is commanded by bert, and was by anna
        200 servo 11 stop → command 11 stop; completed 3
        300 leg 1 set 80 → rejected 4 servo_stopped
        310 leg 1 start 80 (source anna) → …; announce source_changed
        400 leg 1 set 80 → …; announce source_changed
        announces leg 1 is commanded by somebody without a name, and was by anna""",
    "an angle outside a joints limits rejects the whole command": """
        rules joint_limits_cdeg={12: (2000, 16000)}
        1 leg 1 start 10 → rejected 1 joint_limit
        says servo 12 may go from 20 to 160 degrees; 10 is outside
        2 legs 21 start 160.01 → rejected 2 joint_limit
        running none
        3 leg 1 start 20 → command 1 start 20; completed 3
        30 servo 12 set 160 → command 12 set 160; completed 4
        60 servo 11 set 180 → command 11 set 180; completed 5
        61 leg 1 stop | set 170 | set 80 → command 11 stop; rejected 6 joint_limit stopped
        62 leg 1 stop → command 1 stop; completed 7  # a stop has no angle""",
    "a stop goes out at once and ends what waits": """
        100 leg 1 start 90
        101 leg 1 set 80
        102 leg 1 stop → command 1 stop; completed 2 coalesced; completed 3
        120 time → nothing
        mode idle""",
    # Its Stop may have been lost on the wire, which acknowledges nothing.
    "a stop among moves reaches a servo that seems to be stopped": """
        100 leg 1 start 90 | stop | start 90
        101 leg 1 set 80 | stop | set 80 → command 12 stop""",
    "one channels own order is known and no others however long an instant takes": """
        instant 130
        130.5 leg 1 stop (key put leg/1)
        131 leg 1 start 90 (key get leg/1) → rejected 2 servo_stopped
        131.5 leg 1 start 90 (key put leg/1) → command 1 start 90; completed 3""",
    "a stop among moves does not wait for the repeats of an earlier one": """
        rules repeats=3
        100 leg 1 start 90
        110 leg 1 stop | set 80 | set 80 → command 11 stop; command 1 stop | set 80 | set 80; completed 2
        118 leg 1 stop | set 70 | set 70 → command 11 stop; command 1 stop | set 70 | set 70; completed 3""",
    "a stop among moves wins too": """
        130 leg 1 start 90 | stop | start 90 (key leg/1)
        130 servo 12 start 90 (key servo/12) → rejected 2 servo_stopped
        running 11 13""",
    "a leg that need not be energised any more keeps nobody off": """
        rules start_pause_ms=50
        100 servo 22 start 90
        110 servo 21 start 90 → nothing
        112 leg 3 start 90 → nothing
        115 servo 21 stop + servo 22 set 80
        due 150
        150 time → command 3 start 90; completed 3""",
    "a start does not undo the watchdogs stop of its instant": """
        100 leg 1 start 90
        instant 349
        351 leg 1 start 90 (key put leg/1) → watchdog 1 stop; announce watchdog_expired; rejected 2 servo_stopped
        352 leg 1 start 90 (key put leg/1) → rejected 3 servo_stopped""",
    "a stream above the rate that keeps a servo stopped leaves it to the repeats": """
        rules repeats=3
        100 leg 1 start 90
        101 leg 1 stop | set 80 | set 80 → command 11 stop
        102 leg 1 stop | set 70 | set 70 → completed 2 coalesced
        121 time → …; repeat 11 stop; …""",
}
test_a_scene = scene_test(SCENES)


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


# ---- the table of transitions

EVENTS: dict[type[events.Event], events.Event] = {
    events.Command: events.Command(targets_of("servo 11 start 90"), key="leg", number=9),
    events.Reset: events.Reset(number=9),
    events.EmergencyStop: events.EmergencyStop(),
    events.BusOpened: events.BusOpened(),
    events.BusFailed: events.BusFailed("EIO"),
    events.StoppedOutside: events.StoppedOutside(at_work=True),
    events.TimePassed: events.TimePassed(),
    events.ShutDown: events.ShutDown(),
}


RUNS: Final = "rules repeats=1, rest_runs=3\n 1 leg 1 start 90\n 2 leg 1 set 80\n"
WAYS: Final = {
    Mode.STARTING: "rules repeats=1\n unopened",
    Mode.IDLE: "rules repeats=1, rest_runs=3",
    Mode.ACTIVE: RUNS,
    Mode.ESTOPPED: f"{RUNS} 3 estop",
    Mode.BUS_FAULT: f"{RUNS} 3 fail",
    Mode.STOPPING: f"{RUNS} 3 end",
}
"""How a robot comes into a mode, with as much going on in it as there can be."""


@pytest.mark.parametrize("kind", EVENTS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("at_ms", [4, 10_000])
def test_every_event_in_every_mode(mode: Mode, kind: type[events.Event], at_ms: float) -> None:
    robot = play(f"{WAYS[mode]}\n mode {mode}")
    event = replace(EVENTS[kind])
    if kind in TRANSITIONS[mode]:
        robot.take(at_ms, event)
        assert robot.supervisor.mode in TRANSITIONS[mode][kind]
        return
    untouched = copied(robot.supervisor)
    with pytest.raises(IllegalEvent, match=f"{kind.__name__} while {mode}"):
        robot.take(at_ms, event)
    assert (robot.supervisor.mode, robot.supervisor.due_ns) == (untouched.mode, untouched.due_ns)
    rank = {number: number for number in pending(untouched)}
    assert key(robot.supervisor, NS_PER_S, rank) == key(untouched, NS_PER_S, rank)


FAULTS: Final = {
    "after a fault nothing is sent and everything rejected": """
        rules repeats=3
        100 leg 1 start 90
        101 leg 1 set 80
        200 fail → rejected 2 bus_fault; announce bus_fault  # nothing goes out that was due at 120
        pending none
        mode bus_fault
        due never
        203 leg 1 start 90 → rejected 3 bus_fault
        204 leg 1 set 90 → rejected 4 bus_fault
        205 leg 1 stop → rejected 5 bus_fault
        206 reset → rejected 6 bus_fault
        10000 time → nothing""",
    "an emergency stop during a fault latches": """
        100 fail
        110 estop → announce estop_engaged
        mentions follow as soon as it does
        200 open → startup 1-6 stop; …
        mode estopped""",
    "the end during a fault says that no stop was sent until the bus answers": """
        100 fail
        110 end → announce stopping
        mentions no Stop can be sent
        120 open → startup 1-6 stop; …
        mode stopping""",
    "sentences name a plug-in's wire": """
        rules wire="the wire my-board", repeats=0, rest_runs=0
        100 fail
        101 leg 1 start 90 → rejected 1 bus_fault
        mentions the wire my-board is at fault
        110 estop → announce estop_engaged
        mentions the wire my-board does not answer
        200 open → startup 1-6 stop; …
        mentions the wire my-board answers again""",
    "an emergency stop before the bus was ever open latches": """
        unopened
        0 estop → announce estop_engaged
        1 open → startup 1-6 stop
        mode estopped""",
    "a command that starts one leg and stops another does not reject itself": """
        rules start_pause_ms=50
        100 leg 1 start 90
        110 leg 2 start 90 + leg 3 stop (key legs) → command 3 stop
        150 time → command 2 start 90; completed 2""",
    "the end stops all and rejects everything": """
        100 leg 1 start 90
        101 leg 1 set 80
        102 end → shutdown 1-6 stop; rejected 2 stopping; announce stopping
        mode stopping
        103 leg 1 start 90 → rejected 3 stopping
        104 reset → rejected 4 stopping
        105 estop → estop 1-6 stop; announce estop_engaged
        1000 time → nothing""",
}
test_a_scene_with_faults = scene_test(FAULTS)
