"""The exhaustive check finds what is planted in the calibration."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from gateway.robot.core.joint_limits import Reach
from gateway.robot.core.leg import Rules
from gateway.robot.core.supervisor import Supervisor
from tests.fuzz import planted_calibration as planted
from tests.support.history import Violation
from tests.support.model_check import check
from tests.support.small_robots import CONFIGURATIONS, Configuration

BY_NAME = {configuration.name: configuration for configuration in CONFIGURATIONS}
ONE_LEG = BY_NAME["one leg, a servo of which is calibrated"]
LANDING = BY_NAME["one servo, calibrated and limited in speed, and landing"]
DRIVER = BY_NAME["one servo, calibrated by its driver"]
UNREAD = BY_NAME["one servo, whose calibration cannot be read"]

ANGLES = "the newest target is sent|must not go|nobody asked"


@pytest.mark.parametrize(
    ("configuration", "make", "promise"),
    [
        (ONE_LEG, planted.with_reach(planted.FramesAsCommanded), ANGLES),
        (ONE_LEG, planted.with_reach(planted.WholeLegsAsCommanded), ANGLES),
        (ONE_LEG, planted.with_reach(planted.OldWire), ANGLES),
        (LANDING, planted.with_reach(planted.AnyAngle), "rejected for joint_limit"),
        (LANDING, planted.with_reach(planted.LandsWhereTheSettingsSay), "straight line|follows its line"),
        (ONE_LEG, planted.with_calibrating(planted.InForceAtOnce), ANGLES),
        (ONE_LEG, planted.with_calibrating(planted.InForceThoughNotKept), ANGLES),
        (ONE_LEG, planted.with_calibrating(planted.ChangesWhatRuns), "a calibrate rejected for invalid|is not kept"),
        (LANDING, planted.with_calibrating(planted.ChangesWhatWaits), "a calibrate rejected for invalid|is not kept"),
        (ONE_LEG, planted.with_calibrating(planted.StartsMeanwhile), "rejected for servo_stopped"),
        (ONE_LEG, planted.with_calibrating(planted.TheLatestChangeCounts), "is not kept"),
        (ONE_LEG, planted.with_calibrating(planted.AnyRevision), "is not kept"),
        (ONE_LEG, planted.with_calibrating(planted.StandsUpToShow), "although it does not run|nobody asked|is set"),
        (ONE_LEG, planted.CalibratesInAnyMode, "is not kept"),
        (ONE_LEG, planted.StopsWaitForTheDisk, "rejected for"),
        (DRIVER, planted.AnybodyCalibrates, "is not kept"),
        (UNREAD, planted.with_calibrating(planted.StartsUntrusted), "rejected for servo_stopped"),
        (UNREAD, planted.with_calibrating(planted.TrustsAnyAnswer), "rejected for"),
    ],
    ids=lambda value: getattr(value, "name", None) or getattr(value, "__name__", None),
)
def test_it_finds_a_planted_bug(
    configuration: Configuration, make: Callable[[Rules], Supervisor], promise: str
) -> None:
    with pytest.raises(Violation, match=promise):
        check(configuration, make)


def test_a_supervisor_without_a_bug_keeps_every_promise() -> None:
    """Else the bugs planted above might be found for the planting alone."""
    check(replace(UNREAD, commands=UNREAD.commands[:1], waits_ns=UNREAD.waits_ns[:1]), planted.with_reach(Reach))
