"""The exhaustive check finds what is planted in the stop buttons."""

from collections.abc import Callable

import pytest

from gateway.robot.core.buttons import Buttons
from gateway.robot.core.leg import Rules
from gateway.robot.core.supervisor import Supervisor
from tests.fuzz import planted_buttons as planted
from tests.support.history import Violation
from tests.support.model_check import check
from tests.support.small_robots import CONFIGURATIONS, Configuration

BY_NAME = {configuration.name: configuration for configuration in CONFIGURATIONS}
TWO = BY_NAME["two buttons, one of which must be alive"]
LATE = BY_NAME["one button whose messages may be late"]
ANYTHING = BY_NAME["a button that must be alive, and whatever else may happen"]
LANDING = BY_NAME["two legs, landing, and a button that must be alive"]


@pytest.mark.parametrize(
    ("configuration", "make", "promise"),
    [
        (TWO, planted.with_buttons(planted.NeverSilent), "not heard is silent"),
        (TWO, planted.with_buttons(planted.SilentLate), "not heard is silent"),
        (TWO, planted.with_buttons(planted.CountsAgain), "answered with stale"),
        (TWO, planted.with_buttons(planted.AliveOnceRegistered), "are alive, not|rejected for no_button|wakes up"),
        (TWO, planted.with_buttons(planted.OlderOneLivesOn), "are alive, not|unknown_button|not heard is silent"),
        (
            TWO,
            planted.with_buttons(planted.LeavesUnnoticed),
            "too few buttons watch, are stopped|rejected for no_button",
        ),
        (TWO, planted.with_buttons(planted.OneTooFew), "rejected for no_button"),
        (LATE, planted.with_buttons(planted.CountsWhenItComes), "not heard is silent|answered with stale|wakes up"),
        (LATE, planted.with_buttons(planted.RegistrationTellsNoTime), "not heard|answered with stale|wakes up"),
        (ANYTHING, planted.RunsOnUnwatched, "too few buttons watch, are stopped"),
        (ANYTHING, planted.StopsNeedAButton, "rejected for"),
        (ANYTHING, planted.ResetsUnwatched, "a reset rejected for no_button"),
        (ANYTHING, planted.Oversleeps, "wakes up in time|no time but"),
        (ANYTHING, planted.ForgetsThemInFault, "no time but|not heard is silent|answered with"),
        (LANDING, planted.LandsFromNow, "a landing|wakes up in time|are stopped"),
        (LANDING, planted.RunsOnUnwatched, "rejected for landing|are stopped"),
    ],
    ids=lambda value: getattr(value, "name", None) or getattr(value, "__name__", None),
)
def test_it_finds_a_planted_bug(
    configuration: Configuration, make: Callable[[Rules], Supervisor], promise: str
) -> None:
    with pytest.raises(Violation, match=promise):
        check(configuration, make)


def test_buttons_without_a_bug_keep_every_promise() -> None:
    """Else the bugs planted above might be found for the planting alone."""
    check(ANYTHING, planted.with_buttons(Buttons))
