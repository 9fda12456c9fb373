"""The guard at the device's edge: a transfer passes if and only if the framing makes it of a legal frame."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from gateway.errors import SpiError
from gateway.protocol.frames import Frame, FrameError, OneServo, Op, ServoOp, decode, stop_leg
from gateway.protocol.framing import Framing
from gateway.spi.guard import GuardedDevice, IllegalTransferError
from gateway.spi.simulator import SimulatedController
from tests.support.unshared import UnsharedDevice
from tests.unit.test_frames import ILLEGAL, frames

STOP_1 = stop_leg(1).to_bytes()
START_11 = OneServo(11, ServoOp(Op.START, 90_00)).to_bytes()
STOP_WITH_ANGLE = bytes.fromhex("06 02 20 02 5a 00")
ZERO = b"\0"
PREAMBLE = [ZERO] * 16


class Recorder(UnsharedDevice):
    """An SPI device that keeps what it is given, and fails when told to."""

    def __init__(self) -> None:
        self.seen: list[bytes] = []
        self.failing = False
        self.closed = 0

    def transfer(self, data: bytes) -> None:
        if self.failing:
            raise SpiError("told to fail")
        self.seen.append(data)

    def close(self) -> None:
        self.closed += 1


def is_canonical(data: bytes) -> bool:
    try:
        return decode(data).to_bytes() == data
    except FrameError:
        return False


bytes_near_a_frame = st.one_of(
    st.binary(max_size=20),
    st.builds(
        lambda frame, index, value: bytes(value if i == index else byte for i, byte in enumerate(frame.to_bytes())),
        frames,
        st.integers(0, 13),
        st.integers(0, 255),
    ),
)


@given(bytes_near_a_frame)
def test_plain_passes_legal_frames_and_nothing_else(data: bytes) -> None:
    device = Recorder()
    guarded = GuardedDevice(device, Framing.PLAIN)
    if is_canonical(data):
        guarded.transfer(data)
        assert device.seen == [data]
    else:
        with pytest.raises(IllegalTransferError):
            guarded.transfer(data)
        assert device.seen == []


@given(bytes_near_a_frame)
def test_an_announced_body_is_a_legal_frame_of_that_length(data: bytes) -> None:
    for announced in (6, 14):
        device = Recorder()
        guarded = GuardedDevice(device, Framing.LENGTH_PREFIXED)
        guarded.transfer(bytes((announced,)))
        if is_canonical(data) and len(data) == announced:
            guarded.transfer(data)
            assert device.seen[1:] == [data]
        elif data != bytes(1):  # a zero begins to fill the body's place
            with pytest.raises(IllegalTransferError):
                guarded.transfer(data)
            assert device.seen[1:] == []


@given(st.binary(max_size=20))
def test_only_announcements_and_zeros_come_unannounced(data: bytes) -> None:
    device = Recorder()
    guarded = GuardedDevice(device, Framing.LENGTH_PREFIXED)
    if data in (b"\x06", b"\x0e", ZERO):
        guarded.transfer(data)
        assert device.seen == [data]
    else:
        with pytest.raises(IllegalTransferError):
            guarded.transfer(data)
        assert device.seen == []


def test_the_two_lengths_that_may_be_announced() -> None:
    for length in range(1, 256):
        guarded = GuardedDevice(Recorder(), Framing.LENGTH_PREFIXED)
        if length in (6, 14):
            guarded.transfer(bytes((length,)))
        else:
            with pytest.raises(IllegalTransferError, match="announces no frame"):
                guarded.transfer(bytes((length,)))


@given(st.lists(frames, max_size=5))
def test_all_that_a_framing_makes_passes(sent: list[Frame]) -> None:
    for framing in Framing:
        device = Recorder()
        guarded = GuardedDevice(device, framing)
        expected = list(framing.preamble)
        expected += [data for frame in sent for data in framing.transfers(frame.to_bytes())]
        for data in expected:
            guarded.transfer(data)
        assert device.seen == expected


@pytest.mark.parametrize("framing", Framing)
@pytest.mark.parametrize("vector", ILLEGAL, ids=lambda vector: vector["why"])
def test_no_illegal_vector_passes(framing: Framing, vector: dict[str, str]) -> None:
    device = Recorder()
    guarded = GuardedDevice(device, framing)
    data = bytes.fromhex(vector["bytes"])
    if framing is Framing.LENGTH_PREFIXED:
        guarded.transfer(b"\x0e" if len(data) == 14 else b"\x06")
    before = list(device.seen)
    with pytest.raises(IllegalTransferError):
        guarded.transfer(data)
    assert device.seen == before


def test_a_stop_with_an_angle_is_not_what_the_encoder_writes() -> None:
    device = Recorder()
    with pytest.raises(IllegalTransferError, match="06 02 20 02 00 00"):
        GuardedDevice(device, Framing.PLAIN).transfer(STOP_WITH_ANGLE)
    assert device.seen == []


def test_plain_has_no_preamble_and_no_announcements() -> None:
    device = Recorder()
    guarded = GuardedDevice(device, Framing.PLAIN)
    for data in (ZERO, bytes(16), b"\x0e", b"\x06", b""):
        with pytest.raises(IllegalTransferError):
            guarded.transfer(data)
    assert device.seen == []


def test_the_preamble_may_fill_the_place_of_an_announced_body() -> None:
    for announcement in (b"\x06", b"\x0e"):
        device = Recorder()
        guarded = GuardedDevice(device, Framing.LENGTH_PREFIXED)
        sent = [announcement, *PREAMBLE, b"\x0e", STOP_1]
        for data in sent:
            guarded.transfer(data)
        assert device.seen == sent


@pytest.mark.parametrize("zeros", range(1, 16))
@pytest.mark.parametrize("data", [b"\x06", b"\x0e", STOP_1, START_11], ids=["06", "0e", "14 bytes", "6 bytes"])
def test_nothing_comes_into_the_zeros_that_fill_a_bodys_place(zeros: int, data: bytes) -> None:
    """It would be taken for the rest of that body."""
    device = Recorder()
    guarded = GuardedDevice(device, Framing.LENGTH_PREFIXED)
    for sent in (b"\x0e" if len(data) != 6 else b"\x06", *PREAMBLE[:zeros]):
        guarded.transfer(sent)
    before = list(device.seen)
    with pytest.raises(IllegalTransferError):
        guarded.transfer(data)
    assert device.seen == before
    for sent in (*PREAMBLE[zeros:], b"\x0e", STOP_1):
        guarded.transfer(sent)


@pytest.mark.parametrize("zeros", [1, 5, 16, 17])
def test_where_a_length_is_awaited_a_frame_may_come_into_a_preamble(zeros: int) -> None:
    """Zeros are lengths that mean nothing there; a first Stop waits for none of them."""
    device = Recorder()
    guarded = GuardedDevice(device, Framing.LENGTH_PREFIXED)
    for data in (*[ZERO] * zeros, b"\x0e", STOP_1):
        guarded.transfer(data)
    assert len(device.seen) == zeros + 2


@pytest.mark.parametrize("zeros", [bytes(length) for length in range(2, 20)], ids=len)
def test_zeros_in_one_transfer_jam_a_controller_and_never_pass(zeros: bytes) -> None:
    for announcements in ([], [b"\x06"], [b"\x0e"], [b"\x0e", ZERO]):
        device = Recorder()
        guarded = GuardedDevice(device, Framing.LENGTH_PREFIXED)
        for data in announcements:
            guarded.transfer(data)
        with pytest.raises(IllegalTransferError):
            guarded.transfer(zeros)


def test_a_rejection_leaves_the_guard_as_it_was() -> None:
    device = Recorder()
    guarded = GuardedDevice(device, Framing.LENGTH_PREFIXED)
    guarded.transfer(b"\x0e")
    for illegal in (b"\x0e", b"\x06", START_11, b"", STOP_1[:-1]):
        with pytest.raises(IllegalTransferError):
            guarded.transfer(illegal)
    guarded.transfer(STOP_1)
    assert device.seen == [b"\x0e", STOP_1]


@pytest.mark.parametrize("next_transfer", [b"\x06", b"\x0e", ZERO], ids=["06", "0e", "zero"])
@pytest.mark.parametrize(
    "already", [(), (b"\x0e",), (b"\x0e", ZERO)], ids=["announcement fails", "body fails", "a zero fails"]
)
def test_after_a_failed_transfer_comes_an_announcement_or_a_zero(
    already: tuple[bytes, ...], next_transfer: bytes
) -> None:
    device = Recorder()
    guarded = GuardedDevice(device, Framing.LENGTH_PREFIXED)
    for data in already:
        guarded.transfer(data)
    device.failing = True
    with pytest.raises(SpiError):
        guarded.transfer({0: b"\x0e", 1: STOP_1, 2: ZERO}[len(already)])
    device.failing = False
    with pytest.raises(IllegalTransferError):  # nobody knows whether its announcement arrived
        guarded.transfer(STOP_1)
    guarded.transfer(next_transfer)
    assert device.seen == [*already, next_transfer]


def test_a_bug_is_not_an_spi_error() -> None:
    """Else a bug would be taken for a fault of the bus, and tried again for ever."""
    assert not issubclass(IllegalTransferError, SpiError)
    assert issubclass(IllegalTransferError, RuntimeError)


def test_close_reaches_the_device() -> None:
    device = Recorder()
    GuardedDevice(device, Framing.PLAIN).close()
    assert device.closed == 1


class GuardedController(RuleBasedStateMachine):
    """Whatever is tried, in whatever order, a guarded controller keeps its memory and stays synchronised."""

    def __init__(self) -> None:
        super().__init__()
        self.now_ns = 0
        self.controller = SimulatedController(Framing.LENGTH_PREFIXED, clock=lambda: self.now_ns)
        self.guarded = GuardedDevice(self.controller, Framing.LENGTH_PREFIXED)
        self.announced: int | None = None
        self.filled = 0
        self.frames = 0

    @rule(data=st.one_of(bytes_near_a_frame, st.sampled_from([b"\x06", b"\x0e", ZERO, bytes(16), STOP_1, START_11])))
    def try_anything(self, data: bytes) -> None:
        if data == ZERO:
            expected = True
        elif self.announced is None:
            expected = data in (b"\x06", b"\x0e")
        else:
            expected = not self.filled and is_canonical(data) and len(data) == self.announced
        try:
            self.guarded.transfer(data)
        except IllegalTransferError:
            assert not expected
        else:
            assert expected
            self.note(data)
        assert self.controller.executed == self.frames
        assert not self.controller.corruptions

    def note(self, data: bytes) -> None:
        if data == ZERO:
            self.filled += self.announced is not None
            if self.filled == 16:
                self.announced, self.filled = None, 0
        else:
            self.frames += len(data) > 1
            self.announced = data[0] if len(data) == 1 else None

    @precondition(lambda self: self.announced is None)
    @rule(frame=frames)
    def send(self, frame: Frame) -> None:
        for data in Framing.LENGTH_PREFIXED.transfers(frame.to_bytes()):
            self.guarded.transfer(data)
        self.frames += 1
        assert self.controller.executed == self.frames

    @rule()
    def fail_then_recover(self) -> None:
        self.controller.fail_next(1)
        with pytest.raises(SpiError):
            self.guarded.transfer(ZERO)
        for data in PREAMBLE:
            self.guarded.transfer(data)
        self.announced, self.filled = None, 0


TestGuardedController = GuardedController.TestCase
