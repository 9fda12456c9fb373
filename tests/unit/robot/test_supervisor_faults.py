"""Faults of the bus, starts one after the other, the end, and the table of transitions."""

from dataclasses import replace
from typing import Final

import pytest

from gateway.rate_limit import NS_PER_S
from gateway.robot.core import events
from gateway.robot.core.supervisor import IllegalEvent
from schemas.telemetry import Mode
from tests.support.model_check import copied, key, pending
from tests.support.scenes import play, scene_test, targets_of
from tests.support.transitions import TRANSITIONS

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


SCENES: Final = {
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
    "legs are energised with a pause between them": """
        rules start_pause_ms=50
        100 legs 123 start 90 (key legs) → command 1 start 90
        due 150
        149 time → nothing
        150 time → command 2 start 90
        200 time → command 3 start 90; completed 1""",
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
test_a_scene = scene_test(SCENES)
