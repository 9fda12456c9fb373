"""The bus and its device: opened, guarded, released, counted."""

from contextlib import AbstractContextManager, nullcontext

import pytest

from gateway.errors import SpiError
from gateway.protocol.frames import OneLeg, OneServo, Op, ServoOp, stop_leg
from gateway.protocol.framing import PREAMBLE_ZEROS, ZERO, Framing
from gateway.settings import SpiSettings
from gateway.spi.bus import Bus, bus_for
from gateway.spi.guard import GuardedDevice, IllegalTransferError
from tests.support.unshared import UnsharedDevice

PREFIXED = Framing.LENGTH_PREFIXED
START = OneLeg(1, (ServoOp(Op.START, 90_00),) * 3)
STOP = stop_leg(1)


class Devices(UnsharedDevice):
    """Opens devices that all write to one list; each transfer takes 50 µs, and those in `failing` fail."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.opened = self.open_now = 0
        self.locks = 0
        self.written: list[bytes] = []
        self.pauses_s: list[float] = []
        self.failing: set[int] = set()
        """Numbers of transfers, from when it was set."""
        self._count = 0

    def open(self) -> "Devices":
        self.opened += 1
        self.open_now += 1
        return self

    def fail(self, *transfers: int) -> None:
        self.failing, self._count = set(transfers), 0

    def transfer(self, data: bytes) -> None:
        self.now_ns += 50_000
        self._count += 1
        if self._count in self.failing:
            raise SpiError("told to fail")
        self.written.append(data)

    def lock(self) -> AbstractContextManager[None]:
        self.locks += 1
        return nullcontext()

    def close(self) -> None:
        self.open_now -= 1

    def pause(self, duration_s: float) -> None:
        self.pauses_s.append(duration_s)
        self.now_ns += round(duration_s * 1e9)

    def clock(self) -> int:
        return self.now_ns

    def bus(self, framing: Framing = PREFIXED) -> Bus:
        return Bus(self.open, framing, frame_gap_ns=0, clock=self.clock, pause=self.pause)


def test_a_device_that_fails_while_it_is_opened_is_released_and_counted_as_an_error() -> None:
    devices = Devices()
    bus = devices.bus()
    devices.fail(3)
    with pytest.raises(SpiError):
        bus.open()
    assert (devices.open_now, bus.errors) == (0, 1)
    with pytest.raises(SpiError, match="closed"):
        bus.write(STOP)


def test_opening_again_releases_what_was_open() -> None:
    devices = Devices()
    bus = devices.bus()
    for _ in range(5):
        bus.open()
    assert (devices.opened, devices.open_now) == (5, 1)


def test_opening_again_writes_the_preamble_also_where_one_was_the_last_that_was_written() -> None:
    devices = Devices()
    bus = devices.bus()
    for _ in range(2):
        devices.written.clear()
        bus.open()
        assert devices.written == [ZERO] * PREAMBLE_ZEROS


def test_what_it_opens_is_guarded() -> None:
    devices = Devices()
    bus = devices.bus(Framing.PLAIN)
    bus.open()
    illegal = OneServo(11, ServoOp(Op.START, 90_00))
    object.__setattr__(illegal, "servo_id", 99)  # a bug that nobody has made yet
    with pytest.raises(IllegalTransferError):
        bus.write(illegal)
    assert devices.written == []


def test_frames_errors_and_times_are_counted() -> None:
    devices = Devices()
    bus = devices.bus(Framing.PLAIN)
    bus.open()
    devices.fail(2)
    bus.write(START)
    with pytest.raises(SpiError):
        bus.write(STOP)
    bus.write(STOP)
    assert (bus.frames, bus.errors) == (2, 1)
    assert list(bus.transfer_latency.recent_us) == [50] * 3


def test_one_zero_is_no_preamble() -> None:
    devices = Devices()
    bus = devices.bus()
    bus.open()
    assert bus.just_resynchronised
    bus.write(START)
    for zero in range(1, PREAMBLE_ZEROS + 1):
        assert not bus.just_resynchronised
        assert bus.write_zero() is (zero < PREAMBLE_ZEROS)
    assert bus.just_resynchronised


def test_after_a_zero_that_failed_the_next_frame_comes_behind_a_whole_preamble() -> None:
    devices = Devices()
    bus = devices.bus()
    bus.open()
    bus.write(START)
    devices.fail(3)
    assert bus.write_zero()
    assert bus.write_zero()
    with pytest.raises(SpiError):
        bus.write_zero()
    devices.written.clear()
    bus.write(STOP)
    assert devices.written == [*[ZERO] * PREAMBLE_ZEROS, *PREFIXED.transfers(STOP.to_bytes())]


def test_the_settings_say_how_long_the_pauses_are_and_on_a_shared_device_there_are_more() -> None:
    for shared, pauses in ((False, 1), (True, 3)):
        devices = Devices()
        settings = SpiSettings(framing=PREFIXED, frame_gap_us=200)
        bus = bus_for(settings, devices.open, shared_device=shared, clock=devices.clock, pause=devices.pause)
        bus.open()
        devices.now_ns += 1_000_000
        devices.pauses_s.clear()
        bus.write(STOP)
        assert devices.pauses_s == pytest.approx([200e-6] * pauses)


def test_the_bus_lock_is_the_devices() -> None:
    devices = Devices()
    with GuardedDevice(devices, PREFIXED).lock():
        assert devices.locks == 1
