"""Which calls the bus makes where calls fail: in what order, with what time between, and when it gives up.

A call is written here as `z` for each of its zeros, a leg's number for its Stop, `s` for a servo's, and `m` for a frame
that moves. Of what
a controller makes of them: test_bus.py and test_slow_failures.py.
"""

import itertools
from collections.abc import Callable, Iterable

import pytest

from gateway.errors import SpiError
from gateway.host.settings_table import SpiSettings
from gateway.model.frames import STOP, OneLeg, OneServo, Op, ServoOp, stop_leg
from gateway.model.framing import ZERO, Framing
from gateway.robot.protocol import BatchReport
from gateway.robot.spi import Batch, SpiDevice
from gateway.robot.spi.awaited import ANYTHING, NOTHING, after, after_failure, after_stall, next_on_the_way_back
from gateway.robot.spi.bus import Bus
from schemas.robot import LEGS, SERVO_IDS
from tests.support.controllers import Controller

PREFIXED, PLAIN = Framing.LENGTH_PREFIXED, Framing.PLAIN
MS = 1_000_000
MOVE = OneLeg(1, (ServoOp(Op.START, 90_00),) * 3)
STOP_ALL = [stop_leg(leg) for leg in LEGS]
STOP_SERVO = OneServo(11, ServoOp(Op.STOP))
SIGNS = {ZERO: "z", STOP_SERVO.data: "s", **{stop.data: str(leg) for leg, stop in zip(LEGS, STOP_ALL, strict=True)}}


class Scene(SpiDevice):
    """A device whose calls fail where a test says so, the synchronised bus above it, and a clock that they move."""

    def __init__(self, framing: Framing = PREFIXED, *, synchronised: bool = True) -> None:
        self.now_ns = 7_000 * MS
        self.calls: list[str] = []
        self.fails: Callable[[str], bool] = lambda _: False
        self.failure_ns = self.success_ns = 0
        self.stall_ns = 0
        """What the next call takes besides."""
        self.looks = 0
        settings = SpiSettings(speed_hz=2_500_000, framing=framing, frame_gap_us=framing.least_gap_us)
        self.bus = Bus(settings, lambda: self, clock=lambda: self.now_ns)
        self.bus.open()
        if synchronised:
            self.stop(preamble=True)
            self.calls.clear()

    def transfer(self, batch: Batch) -> None:
        call = "".join(SIGNS.get(data, "m") for data, _ in batch if len(data) > 1 or data == ZERO)
        self.calls.append(call)
        failed = self.fails(call)
        self.now_ns += self.stall_ns + (self.failure_ns if failed else self.success_ns)
        self.stall_ns = 0
        if failed:
            raise SpiError(f"{call} failed")

    def put_right(self) -> None:
        self.looks += 1

    def stop(self, *legs: int, preamble: bool = False) -> BatchReport:
        return self.bus.write([stop_leg(leg) for leg in legs or LEGS], preamble=preamble)

    def move(self) -> BatchReport:
        return self.bus.write([MOVE])

    @property
    def made(self) -> list[str]:
        """The calls since it was last asked."""
        made, self.calls = self.calls, []
        return made

    def fail_at(self, numbers: Iterable[int]) -> None:
        """Let these calls fail, counted from 1, from now on."""
        failing, count = frozenset(numbers), itertools.count(1)
        self.fails = lambda _: next(count) in failing

    def move_failed_in(self, took_ns: int) -> None:
        """One frame that moves, and no call after it, failed in so long."""
        self.fail_at({1})
        self.failure_ns = took_ns
        assert self.move().fault is not None
        self.failure_ns = 0
        self.calls.clear()


# ---- calls that fail slowly


@pytest.mark.parametrize(("took_ns", "one_by_one"), [(20 * MS - 1, False), (20 * MS, True)])
@pytest.mark.parametrize("framing", Framing)
def test_from_20_ms_on_a_failure_is_slow_and_the_next_stops_are_written_one_by_one(
    framing: Framing, took_ns: int, one_by_one: bool
) -> None:
    scene = Scene(framing)
    scene.move_failed_in(took_ns)
    assert scene.stop().fault is None
    assert (not any(call.endswith("123456") for call in scene.made)) is one_by_one


@pytest.mark.parametrize(("framing", "zeros"), [(PLAIN, []), (PREFIXED, ["zzzzzzzz"] * 2)])
def test_stops_leave_together_again_once_all_have_passed_and_a_frame_that_moves_does_not_count(
    framing: Framing, zeros: list[str]
) -> None:
    scene = Scene(framing)
    scene.move_failed_in(200 * MS)
    assert scene.move().fault is None
    assert scene.made == [*zeros, "m"]
    assert scene.stop().fault is None
    assert scene.made == ["6", "5", "4", "3", "2", "1", *zeros]
    assert scene.stop().fault is None
    assert scene.made == ["123456"]


def test_the_first_failure_among_stops_that_are_written_one_by_one_is_reported_and_they_stay_so() -> None:
    scene = Scene(PLAIN)
    scene.move_failed_in(200 * MS)
    scene.fail_at({1, 3})
    assert str(scene.stop().fault) == "6 failed"
    assert scene.made == ["6", "5", "4", "3", "2", "1", "6", "4"]
    scene.stop()
    assert scene.made == ["6", "5", "4", "3", "2", "1"]


def test_stops_that_pass_too_slowly_are_a_fault_that_says_so() -> None:
    """The loop stands still meanwhile, and the watchdog of the service waits for a second."""
    scene = Scene(PLAIN)
    scene.move_failed_in(200 * MS)
    scene.success_ns = 100 * MS
    assert "did not accept all Stops in time" in str(scene.stop().fault)
    assert scene.made == ["6", "5", "4"], "300 ms"


def test_a_call_of_stops_that_stalled_is_no_call_of_zeros_that_failed() -> None:
    scene = Scene()
    scene.stall_ns = 900 * MS
    assert "took 0.9 s" in str(scene.stop(1).fault)
    assert scene.made[:2] == ["1", "z"], "zeros are tried first"


# ---- the order


def test_a_leg_whose_stop_did_not_pass_comes_first_the_next_time() -> None:
    scene = Scene(PLAIN)
    scene.fails = lambda call: "1" in call
    scene.stop()
    assert scene.made[:8] == ["123456", "6", "5", "4", "3", "2", "1", "1"]
    scene.fail_at({1})
    scene.stop()
    assert scene.made == ["123456", "1", "6", "5", "4", "3", "2"]


def test_another_legs_stop_brings_the_controller_back_where_the_last_one_fails_again_and_again() -> None:
    """Two transfers do what takes fourteen zeros, also where that leg's Stop has passed already."""
    scene = Scene()
    scene.fails = lambda call: "1" in call
    scene.stop()
    assert scene.made[:11] == ["123456", "6", "5", "4", "3", "2", "1", "6", "1", "6", "1"]


def test_a_stop_that_passed_is_written_again_where_that_is_the_shortest_way_back() -> None:
    scene = Scene()
    scene.move_failed_in(200 * MS)
    scene.move()
    scene.calls.clear()
    scene.fails = lambda call: "2" in call
    scene.bus.write([stop_leg(2), STOP_SERVO])
    assert scene.made[:8] == ["s", *"2222", "s", "s", "2"], "four transfers instead of fourteen"


# ---- zeros that fail


def test_behind_six_calls_of_zeros_that_failed_all_stops_are_tried_without_and_then_zeros_again() -> None:
    """Three zeros in a call, and eighteen calls in all: then the device is opened again."""
    scene = Scene(synchronised=False)
    scene.fails = lambda _: True
    scene.stop()
    zeros = ["zzz"] * 6
    assert scene.made == ["z" * 16 + "123456", *zeros, "123456", *zeros, "123456", *zeros[:4]]


@pytest.mark.parametrize(("each_ms", "calls"), [(200, "111 1z zz zz 1z"), (225, "111 1z zz z1 z")])
def test_calls_of_zeros_that_took_900_ms_to_fail_are_enough_though_they_were_few(each_ms: int, calls: str) -> None:
    scene = Scene()
    scene.fails, scene.failure_ns = lambda _: True, each_ms * MS
    for _ in range(5):
        scene.stop(1)
    assert "".join(scene.made).startswith(calls.replace(" ", ""))


# ---- what outlasts what


# ---- What the controller may still await after calls that failed, and the shortest way back


LEG_STOPS = tuple(stop_leg(leg).to_bytes() for leg in LEGS)
STOPS = (*LEG_STOPS, *(OneServo(servo_id, STOP).to_bytes() for servo_id in SERVO_IDS))


def transfers_of(stop: bytes) -> tuple[bytes, ...]:
    return (ZERO,) if stop == ZERO else (stop[:1], stop)


def awaiting(count: int) -> Controller:
    """A controller with no servo on that awaits so many bytes."""
    controller = Controller(Framing.LENGTH_PREFIXED, clock=lambda: 0)
    controller.take(bytes((count,)))
    assert controller.missing == count
    return controller


@pytest.mark.parametrize("count", range(64))
def test_from_wherever_a_controller_is_stops_and_zeros_start_nothing_and_harm_nothing(count: int) -> None:
    """And what it then awaits is what is computed, for each two of them."""
    for pair in itertools.product((*STOPS[:8], STOPS[-1], ZERO), (*STOPS, ZERO)):
        controller, awaited = awaiting(count), frozenset({count})
        for stop in pair:
            for data in transfers_of(stop):
                controller.take(data)
                awaited = after(awaited, (data,))
        assert awaited == {controller.missing}, pair
        assert not controller.energised
        assert not controller.corruptions
        assert controller.dead is None


def test_what_may_have_been_lost_is_each_transfer_and_those_behind_it() -> None:
    assert after_failure(NOTHING, ()) == NOTHING
    assert after_failure(NOTHING, [ZERO] * 16) == NOTHING, "zeros do a synchronised controller nothing"
    assert after_failure(NOTHING, transfers_of(LEG_STOPS[0])) == {0, 14}
    assert after_failure(frozenset({0, 14}), transfers_of(LEG_STOPS[0])) == {0, 13, 14}
    assert after_failure(ANYTHING, [ZERO]) == ANYTHING
    assert after(ANYTHING, [ZERO] * 14) == NOTHING


def test_a_controller_that_gave_up_within_a_frame_may_await_the_last_byte_of_another() -> None:
    """It takes the body's first byte for a length; each frame behind it leaves it so, and only zeros bring it back."""
    possible = after_stall(NOTHING, transfers_of(LEG_STOPS[0]))
    assert possible == {0, 1, 14}
    assert after(frozenset({1}), transfers_of(LEG_STOPS[1])) == {1}


@pytest.mark.parametrize("stop", LEG_STOPS)
def test_one_stop_of_a_leg_brings_back_a_controller_that_lost_up_to_three_bodies(stop: bytes) -> None:
    awaited = NOTHING
    for _ in range(3):
        awaited = after_failure(awaited, transfers_of(stop))
        assert next_on_the_way_back(awaited, (stop,)) == stop
        assert after(awaited, transfers_of(stop)) == NOTHING


@pytest.mark.parametrize("failures", range(7))
def test_the_way_back_ends(failures: int) -> None:
    awaited, written = NOTHING, 0
    for number in range(failures):
        awaited = after_failure(awaited, transfers_of(LEG_STOPS[number % 6]))
    while awaited != NOTHING:
        unit = next_on_the_way_back(awaited, LEG_STOPS[:3])
        awaited = after(awaited, transfers_of(unit))
        written += len(transfers_of(unit))
    assert written <= 63, "the longest length that a Stop has in it"
    assert next_on_the_way_back(NOTHING, LEG_STOPS) == LEG_STOPS[0]


def test_where_stops_lead_nowhere_soon_it_is_zeros() -> None:
    assert next_on_the_way_back(ANYTHING, LEG_STOPS[:3]) == ZERO
    assert next_on_the_way_back(frozenset({1}), LEG_STOPS[:3]) == ZERO, "one transfer, not two"
