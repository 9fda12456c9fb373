"""The bus: what is written after transfers that failed, and what a controller makes of it.

When else the preamble is written, and the pauses, are in test_bus_preamble.py.
"""

import itertools
from collections.abc import Iterable, Iterator, Sequence

import pytest

from gateway.errors import SpiError
from gateway.protocol.frames import Frame, OneLeg, OneServo, Op, ServoOp, stop_leg
from gateway.protocol.framing import ZERO, Framing
from gateway.spi.bus import Bus
from gateway.spi.simulator import SimulatedController
from schemas.robot import LEGS
from tests.support.unshared import UnsharedDevice

START_11 = OneServo(11, ServoOp(Op.START, 6_00))
START_2 = OneLeg(2, (ServoOp(Op.START, 6_06), ServoOp(Op.START, 14_02), ServoOp(Op.START, 6_14)))
"""Angles that look like lengths to a controller out of sync."""
START_ALL = [OneLeg(leg, (ServoOp(Op.START, 90_00),) * 3) for leg in LEGS]
STOP_ALL = [stop_leg(leg) for leg in LEGS]
OPENING = {framing: len(framing.preamble) for framing in Framing}
"""Transfers that opening makes, and which are not made to fail here."""


class FailingDevice(UnsharedDevice):
    """Hands transfers on to a controller, and fails those whose number is told."""

    def __init__(self, controller: SimulatedController, failing: Iterable[int]) -> None:
        self._controller = controller
        self._failing = frozenset(failing)
        self._numbers = itertools.count()
        self.seen: list[bytes] = []

    def transfer(self, data: bytes) -> None:
        self.seen.append(data)
        if next(self._numbers) in self._failing:
            raise SpiError("told to fail")
        self._controller.transfer(data)

    def heal(self) -> None:
        self._failing = frozenset()


def moving(framing: Framing) -> SimulatedController:
    """A controller with all 18 servos on."""
    controller = SimulatedController(framing, clock=lambda: 0)
    write_all(opened(FailingDevice(controller, ()), framing), START_ALL)
    assert len(controller.energised) == 18
    return controller


def opened(device: FailingDevice, framing: Framing) -> Bus:
    bus = Bus(lambda: device, framing, frame_gap_ns=0)
    bus.open()
    return bus


def write_all(bus: Bus, frames: Sequence[Frame]) -> set[int]:
    """Write them as the service does: whatever fails, the next is tried. Which of them were written."""
    written = set()
    for index, frame in enumerate(frames):
        try:
            bus.write(frame)
            written.add(index)
        except SpiError:
            continue
    return written


def few_of(begin: int, count: int) -> Iterator[tuple[int, ...]]:
    for failures in range(4):
        yield from itertools.combinations(range(begin, begin + count), failures)


@pytest.mark.parametrize("framing", Framing)
@pytest.mark.parametrize("first", [START_11, START_2], ids=["servo", "leg"])
def test_wherever_up_to_three_transfers_fail_each_stop_written_is_understood(framing: Framing, first: Frame) -> None:
    for failing in few_of(OPENING[framing], 20):
        controller = moving(framing)
        device = FailingDevice(controller, failing)
        bus = opened(device, framing)
        written = write_all(bus, [first, *STOP_ALL])
        stopped = {leg for leg in LEGS if leg in written}
        assert {servo // 10 for servo in controller.energised} <= set(LEGS) - stopped, failing
        device.heal()
        write_all(bus, STOP_ALL)
        assert not controller.energised, failing
        assert not controller.corruptions, failing


def test_after_a_failed_transfer_the_preamble_comes_first() -> None:
    framing = Framing.LENGTH_PREFIXED
    device = FailingDevice(SimulatedController(framing), {17})  # the first body
    write_all(opened(device, framing), [START_11, *STOP_ALL[:2]])
    assert device.seen == [
        *framing.preamble,
        *framing.transfers(START_11.to_bytes()),
        *framing.preamble,
        *framing.transfers(STOP_ALL[0].to_bytes()),
        *framing.transfers(STOP_ALL[1].to_bytes()),
    ]


@pytest.mark.parametrize("zero", range(16))
def test_zeros_that_fail_are_begun_anew_for_a_stop_and_for_nothing_else(zero: int) -> None:
    """It counts as failed, and the preamble comes again: nobody knows what a transfer that failed has left behind."""
    framing = Framing.LENGTH_PREFIXED
    for frame, tried in (
        (STOP_ALL[0], [*framing.preamble, *framing.transfers(STOP_ALL[0].to_bytes())]),
        (START_11, []),
    ):
        device = FailingDevice(SimulatedController(framing), {16, 17 + zero})  # an announcement, then a zero
        bus = opened(device, framing)
        assert write_all(bus, [START_11, frame]) == set()
        assert device.seen[17:] == [*[ZERO] * (zero + 1), *tried]
        assert bus.frames == bool(tried), "what is on the wire is counted, even if it counts as failed"
        assert write_all(bus, [STOP_ALL[1]]) == {0}
        assert device.seen[17 + zero + 1 + len(tried) :][:16] == list(framing.preamble)
        assert bus.errors == 2


def test_a_stop_is_tried_also_behind_zeros_that_fail_again_and_again() -> None:
    """The controller may be synchronised, and then it hears it."""
    framing = Framing.LENGTH_PREFIXED
    controller = moving(framing)
    device = FailingDevice(controller, {16, *range(17, 21)})
    bus = opened(device, framing)
    assert write_all(bus, [START_11, STOP_ALL[3]]) == set()
    assert device.seen[17:] == [*[ZERO] * 4, *framing.transfers(STOP_ALL[3].to_bytes())]
    assert not {41, 42, 43} & controller.energised


def test_plain_has_no_preamble_to_send() -> None:
    device = FailingDevice(SimulatedController(Framing.PLAIN), {0})
    write_all(opened(device, Framing.PLAIN), STOP_ALL[:2])
    assert device.seen == [frame.to_bytes() for frame in STOP_ALL[:2]]
