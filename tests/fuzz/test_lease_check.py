"""The exhaustive check finds what is planted in the lease."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from gateway.robot.core.lease import Lease
from gateway.robot.core.leg import Rules
from gateway.robot.core.supervisor import Supervisor
from tests.fuzz import planted_lease as planted
from tests.support.history import Violation
from tests.support.model_check import check
from tests.support.small_robots import CONFIGURATIONS, TICK, Configuration

BY_NAME = {configuration.name: configuration for configuration in CONFIGURATIONS}
TWO_DRIVERS = BY_NAME["two drivers and one lease"]
REQUIRED = BY_NAME["a lease that must be held and is never taken, and whatever else may happen"]


WAITED_FOR = replace(TWO_DRIVERS.rules, period_ns=8 * TICK)
SLOW = replace(TWO_DRIVERS, name="one driver and rate slots that are waited for", rules=WAITED_FOR, drivers=("anna",))


@pytest.mark.parametrize(
    ("configuration", "make", "promise"),
    [
        (TWO_DRIVERS, planted.with_lease(planted.OldTokensStillMove), "rejected for not_holder"),
        (TWO_DRIVERS, planted.with_lease(planted.AnyTokenMoves), "rejected for not_holder"),
        (TWO_DRIVERS, planted.with_lease(planted.FormerHolderDrivesOn), "rejected for|hears the token|is answered"),
        (TWO_DRIVERS, planted.with_lease(planted.HandedOverToAnybody), "acquire is answered with lease_held"),
        (TWO_DRIVERS, planted.with_lease(planted.AnyStopKeepsIt), "falls silent|wakes up in time"),
        (TWO_DRIVERS, planted.with_lease(planted.NeverExpires), "falls silent"),
        (TWO_DRIVERS, planted.with_lease(planted.ExpiresLate), "falls silent"),
        (TWO_DRIVERS, planted.with_lease(planted.OpenWhileHandedOver), "rejected for not_holder"),
        (TWO_DRIVERS, planted.TakesWithoutStops, "a Stop to each leg"),
        (TWO_DRIVERS, planted.StopsNeedTheLease, "rejected for"),
        (SLOW, planted.OthersStartsWait, "under no new holder"),
        (TWO_DRIVERS, planted.OversleepsTheLease, "wakes up in time"),
        (REQUIRED, planted.with_lease(planted.TakenByTheWrongRule), "take is answered with lease_denied|leads"),
        (REQUIRED, planted.OversleepsTheLease, "no time but the lease's|wakes up in time"),
        (REQUIRED, planted.LosesItInFault, "no time but the lease's"),
    ],
    ids=lambda value: getattr(value, "name", None) or getattr(value, "__name__", None),
)
def test_it_finds_a_planted_bug(
    configuration: Configuration, make: Callable[[Rules], Supervisor], promise: str
) -> None:
    with pytest.raises(Violation, match=promise):
        check(configuration, make)


def test_a_lease_without_a_bug_keeps_every_promise_so_far() -> None:
    """Else the bugs planted above might be found for the planting alone."""
    check(BY_NAME["a rate slot later than the watchdog"], planted.with_lease(Lease))
