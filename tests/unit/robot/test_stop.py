"""The last attempt to stop the robot: each leg is tried, whatever another one's Stop met."""

import pytest

from gateway.errors import SpiError
from gateway.robot.protocol.frames import stop_leg
from gateway.robot.settings import SpiSettings
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.stop_all import stop_once
from schemas.robot import LEGS
from tests.support.unshared import UnsharedDevice

MISTAKES = [SpiError("told to fail"), SystemError("returned NULL"), TypeError("a mistake of our own"), KeyError(3)]


class Device(UnsharedDevice):
    """Fails the transfers that carry one leg's Stop (and with it its whole batch), or each opening."""

    def __init__(self, mistake: Exception, leg: int | None) -> None:
        self._mistake = mistake
        self._failing = None if leg is None else stop_leg(leg).to_bytes()
        self.openings = 0
        self.seen: list[bytes] = []

    def open(self) -> "Device":
        self.openings += 1
        if self._failing is None:
            raise self._mistake
        return self

    def take(self, data: bytes) -> None:
        if data == self._failing:
            raise self._mistake
        self.seen.append(data)


@pytest.mark.parametrize("mistake", MISTAKES, ids=repr)
@pytest.mark.parametrize("leg", LEGS)
def test_whatever_one_legs_stop_meets_the_others_get_theirs(mistake: Exception, leg: int) -> None:
    device = Device(mistake, leg)
    bus = Bus(SpiSettings(), device.open)
    bus.open()
    for _ in range(2):  # again and again
        device.seen.clear()
        stopped, fault = stop_once(bus, opened=True)
        assert stopped == set(LEGS) - {leg}
        assert fault is mistake
        expected = [stop_leg(other).to_bytes() for other in LEGS if other != leg]
        assert sorted(set(device.seen)) == expected


@pytest.mark.parametrize("mistake", MISTAKES, ids=repr)
def test_each_leg_tries_to_open_a_device_that_does_not_answer(mistake: Exception) -> None:
    device = Device(mistake, None)
    assert stop_once(Bus(SpiSettings(), device.open)) == (set(), mistake)
    assert device.openings == 1 + len(LEGS)


def test_a_device_that_works_is_not_opened_again() -> None:
    """Opening could fail where writing does not: no descriptor may be left for it."""
    device = Device(KeyError(), LEGS[-1])
    bus = Bus(SpiSettings(), device.open)
    bus.open()
    stop_once(bus, opened=True)
    assert device.openings == 1
