"""The exhaustive check of the supervisor finds nothing."""

from collections import deque

import pytest

from tests.support.model_check import Key, State, check, start, successors
from tests.support.small_robots import CONFIGURATIONS, Configuration

COMPARED = (
    *("one servo, two channels", "one servo, instants in which time passes"),
    *("two legs, rate slots later than the watchdog", "two legs, started one after the other"),
    "one leg, a servo of which is calibrated",
)
MOST_STATES = 60_000
"""Some minutes of search; the largest of these robots has a third of them."""


@pytest.mark.parametrize("most_states", [400, pytest.param(2500, marks=pytest.mark.searches)])
@pytest.mark.parametrize("configuration", CONFIGURATIONS, ids=lambda configuration: configuration.name)
def test_the_states_near_the_beginning_keep_every_promise(configuration: Configuration, most_states: int) -> None:
    """In `make test` some three commands deep; in `make test-all` a third of these robots whole."""
    report = check(configuration, most_states=most_states)
    print(f"{configuration.name}: {report.states} states, {report.steps} steps{', all' if report.whole else ''}")
    assert report.states >= 400


@pytest.mark.searches
@pytest.mark.nightly
@pytest.mark.parametrize("configuration", CONFIGURATIONS, ids=lambda configuration: configuration.name)
def test_every_reachable_state_keeps_every_promise(configuration: Configuration) -> None:
    report = check(configuration, most_states=MOST_STATES)
    print(f"{configuration.name}: {report.states} states, {report.steps} steps")
    assert report.states > 500, "so few states: the events do not reach what they should"
    assert report.whole, "so many states: a time or a count has no end, or the robot is too large to be searched"


@pytest.mark.parametrize("name", COMPARED)
def test_states_that_count_as_one_have_one_future(name: str) -> None:
    """What tells states apart leaves nothing out that matters: of two that look alike, the same follows."""
    (configuration,) = (each for each in CONFIGURATIONS if each.name == name)
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
