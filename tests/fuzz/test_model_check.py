"""The exhaustive check of the supervisor finds nothing, and finds what is planted in it."""

from collections import deque
from collections.abc import Callable, Mapping
from multiprocessing.pool import AsyncResult

import pytest

from gateway.robot.core.leg import Rules
from gateway.robot.core.supervisor import Supervisor
from tests.fuzz import planted, planted_motion
from tests.support.history import Violation
from tests.support.model_check import Key, Report, State, check, start, successors
from tests.support.small_robots import CONFIGURATIONS, Configuration

BY_NAME = {configuration.name: configuration for configuration in CONFIGURATIONS}
ONE_SERVO = BY_NAME["one servo, two channels"]
INSTANTS = BY_NAME["one servo, instants in which time passes"]
JOINTS = BY_NAME["one leg, its joints apart"]
ONE_LEG = BY_NAME["one leg, commands for all of it and for a servo"]
QUARTER = BY_NAME["one leg, frames a quarter of a period apart"]
SLOW = BY_NAME["a rate slot later than the watchdog"]
TWO_SLOW_LEGS = BY_NAME["two legs, rate slots later than the watchdog"]
WHOLE_ROBOT = BY_NAME["two legs, one silent leg stops both"]
STAGGERED = BY_NAME["two legs, started one after the other"]
SPEED = BY_NAME["one leg, a limited speed"]
LANDING = BY_NAME["two legs, landing"]
AVOIDED = BY_NAME["one servo, angles that are never sent, and a limited speed"]
AVOIDED_LANDING = BY_NAME["one leg, angles that are never sent, and landing"]
CALIBRATED = BY_NAME["one leg, a servo of which is calibrated"]


@pytest.mark.parametrize("configuration", CONFIGURATIONS, ids=lambda configuration: configuration.name)
def test_every_reachable_state_keeps_every_promise(
    configuration: Configuration, searches: Mapping[str, AsyncResult[Report]]
) -> None:
    report = searches[configuration.name].get()
    print(f"{configuration.name}: {report.states} states, {report.steps} steps")
    assert report.states > 500, "so few states: the events do not reach what they should"


@pytest.mark.parametrize(
    "configuration", [ONE_SERVO, INSTANTS, TWO_SLOW_LEGS, STAGGERED, CALIBRATED], ids=lambda each: each.name
)
def test_states_that_count_as_one_have_one_future(configuration: Configuration) -> None:
    """What tells states apart leaves nothing out that matters: of two that look alike, the same follows."""
    futures: dict[Key, list[Key]] = {}
    alike: list[tuple[Key, State]] = []
    first: Key = ((), ())
    frontier = deque([(first, start(configuration))])
    queued: set[Key] = set()
    met = 0
    while frontier:
        looks, state = frontier.popleft()
        futures[looks] = []
        for found, after in successors(configuration, state):
            futures[looks].append(found)
            if found not in queued:
                queued.add(found)
                frontier.append((found, after))
            elif (met := met + 1) % 61 == 0:
                alike.append((found, after))
        if len(futures) == 500:
            break
    compared = [(looks, state) for looks, state in alike if looks in futures]
    assert len(compared) > 50
    for looks, state in compared:
        assert [found for found, _ in successors(configuration, state)] == futures[looks], state.path()


# ---- planted bugs


def test_parts_without_a_bug_keep_every_promise() -> None:
    """Else the bugs planted below might be found for the planting alone."""
    check(SLOW, planted.with_parts())


@pytest.mark.parametrize(
    ("configuration", "make", "promise"),
    [
        (SLOW, planted.with_parts(leg=planted.WatchdogWithoutWaitingStarts), "not heard for the timeout"),
        (JOINTS, planted.with_parts(leg=planted.WatchdogWithoutJoint3), "not heard for the timeout|wakes up in time"),
        (JOINTS, planted.with_legs(planted.StopsFeed), "not heard for the timeout|wakes up in time"),
        (INSTANTS, planted.InstantsOfTheirOwn, "rejected for servo_stopped|rejected for estopped"),
        (INSTANTS, planted.LatchedWhenDealtWith, "a reset rejected for estopped"),
        (INSTANTS, planted.AnyNumberResets, "a reset rejected for estopped"),
        (INSTANTS, planted.NumbersToComeReset, "a reset rejected for estopped"),
        (INSTANTS, planted.UnnumberedResetsAtOnce, "a reset rejected for estopped"),
        (INSTANTS, planted.CountsOnlyTheFirst, "emergency stops were requested"),
        (INSTANTS, planted.KeepsTheFirstInstant, "a reset rejected for estopped"),
        (ONE_SERVO, planted.with_parts(servo=planted.SetStarts), "rejected for servo_stopped"),
        (ONE_SERVO, planted.with_parts(servo=planted.ForgetsOthersStops), "rejected for servo_stopped"),
        (ONE_SERVO, planted.with_parts(slots=planted.NeverSkips), "no frame without a rate slot"),
        (ONE_SERVO, planted.with_parts(slots=planted.Bursts), "no burst"),
        (QUARTER, planted.with_parts(slots=planted.Bursts), "no burst"),
        (ONE_SERVO, planted.with_parts(slots=planted.NoBucket), "sent when the rate slot comes|wakes up in time"),
        (ONE_SERVO, planted.with_legs(planted.StopsTakeSlots), "is sent at once"),
        (ONE_SERVO, planted.with_legs(planted.RepeatsAfterStart), "wake up|repeated any more"),
        (ONE_SERVO, planted.with_legs(planted.OlderStartSurvivesStop), "every command is answered|nobody asked"),
        (
            TWO_SLOW_LEGS,
            planted.with_legs(planted.RejectedInPart),
            "every command is answered|nobody asked|wakes up in time|KeyError",  # counted off twice
        ),
        (ONE_LEG, planted.LatchLostInFault, "the mode is estopped"),
        (ONE_LEG, planted.LateCommandsCount, "not heard for the timeout"),
        (ONE_LEG, planted.RejectedCommandsFeed, "wakes up in time|not heard for the timeout"),
        (ONE_SERVO, planted.OversleepsTheWatchdog, "wakes up in time"),
        (ONE_SERVO, planted.EmergencyStopAfterSlots, "a Stop to each leg and nothing else"),
        (ONE_SERVO, planted.ResetInTheSameInstant, "a reset rejected for estopped"),
        (ONE_LEG, planted.RecoversWithoutStops, "a Stop to each leg"),
        (ONE_LEG, planted.BelievesInStopsFromOutside, "a Stop to each leg"),
        (ONE_LEG, planted.StartsBesideStopServos, "rejected for servo_stopped|announced once"),
        (WHOLE_ROBOT, planted.OneSilentLegOnly, "not heard for the timeout"),
        (STAGGERED, planted.with_legs(planted.AllAtOnce), "with a pause"),
        (LANDING, planted_motion.LandingWithoutEnd, "not heard for the timeout|a landing ends in time"),
        (LANDING, planted_motion.LandingMadeLonger, "not heard for the timeout|wakes up|leaves its straight line"),
        (LANDING, planted_motion.CommandsDuringLanding, "rejected for landing"),
        (LANDING, planted_motion.LandsAfterEmergencyStop, "the mode is|wakes up"),
        (
            LANDING,
            planted.with_legs(planted_motion.StartsWhileLanding),
            "is started|nothing moves unasked|nobody asked|set although",
        ),
        (LANDING, planted.with_legs(planted_motion.LandsAtOnce), "leaves its straight line"),
        (LANDING, planted.with_legs(planted_motion.MakesUpForAStall), "leaves its straight line"),
        (LANDING, planted.with_legs(planted_motion.LandsFasterWhereItIsLate), "leaves its straight line"),
        (AVOIDED, planted_motion.avoiding(planted_motion.SendsWhatIsAvoided), "where it must not go"),
        (AVOIDED_LANDING, planted_motion.avoiding(planted_motion.SendsWhatIsAvoided), "where it must not go"),
        (AVOIDED, planted_motion.avoiding(planted_motion.CrossesAtOnce), "no faster than its speed"),
        (SPEED, planted.with_legs(planted_motion.Jumps), "no faster than its speed"),
        (SPEED, planted.with_legs(planted_motion.TakesOneStep), "wakes up in time"),
        (SPEED, planted.with_legs(planted_motion.TimeCountsTwice), "no faster than its speed"),
        (SPEED, planted.with_legs(planted_motion.GoesOnAfterStop), "although it does not run|wakes up in time"),
    ],
    ids=lambda value: getattr(value, "name", None) or getattr(value, "__name__", None),
)
def test_it_finds_a_planted_bug(
    configuration: Configuration, make: Callable[[Rules], Supervisor], promise: str
) -> None:
    with pytest.raises(Violation, match=promise):
        check(configuration, make)
