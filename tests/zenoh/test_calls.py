"""A setpoint costs no more Python calls than it did: a figure that is the same on every machine."""

from tests.benchmarks.calls import HELD_CALLS, measured

TRIES = 3


def test_a_setpoint_takes_no_more_calls_than_it_did() -> None:
    found: list[float] = []
    while len(found) < TRIES and (not found or found[-1] > HELD_CALLS):
        found.append(measured(run_s=1.0)["calls"])
    assert min(found) <= HELD_CALLS, found
