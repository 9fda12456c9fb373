"""The simulated controller against what was measured with the published firmware, on a virtual clock."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.model.frames import OneLeg, Op, ServoOp
from gateway.model.framing import Framing
from gateway.simulation.controller import ServoState
from tests.fuzz.targets import PAUSES_NS, fuzz_simulator
from tests.support.controllers import Controller
from tests.support.transfers import on_wire
from tests.unit.model.test_frames import bytes_near_a_frame, frames

MS = 1_000_000  # ns
START_11 = bytes.fromhex("06 02 0b 01 5a 00")
STOP_11 = bytes.fromhex("06 02 0b 02 00 00")
START_LEG_1 = bytes.fromhex("0e 01 0b 01 5a 00 0c 01 5a 00 0d 01 5a 00")


class Bench:
    """A controller, its clock, and what it said."""

    def __init__(self, framing: Framing, *, tick_phase_ns: int = 0) -> None:
        self.framing = framing
        self.now_ns = 5_000_000 * MS
        self.said: list[str] = []
        self.controller = Controller(
            framing,
            clock=lambda: self.now_ns,
            on_change=self.said.append,
            tick_phase_ns=tick_phase_ns,
        )

    def transfer(self, *transfers: str | bytes) -> None:
        for data in transfers:
            self.controller.take(bytes.fromhex(data) if isinstance(data, str) else data)

    def send(self, *sent: bytes) -> None:
        for frame in sent:
            self.transfer(*on_wire(self.framing, frame))

    def servo(self, servo_id: int) -> ServoState:
        return self.controller.servos[servo_id]


@pytest.fixture
def plain() -> Bench:
    return Bench(Framing.PLAIN)


@pytest.fixture
def prefixed() -> Bench:
    return Bench(Framing.LENGTH_PREFIXED)


@pytest.fixture(params=list(Framing))
def bench(request: pytest.FixtureRequest) -> Bench:
    return Bench(request.param)


# ---- one stream of bytes, in and out of sync


@given(
    st.sampled_from(Framing),
    st.lists(
        st.tuples(
            st.sampled_from(range(len(PAUSES_NS))),
            frames.map(lambda frame: frame.to_bytes())
            | bytes_near_a_frame
            | st.sampled_from([b"\6", b"\x0e", b"\x5a", bytes(16), bytes(70)]),
        ),
        max_size=20,
    ),
)
def test_whatever_comes_it_does_what_a_second_reading_of_the_firmware_does(
    framing: Framing, sent: list[tuple[int, bytes]]
) -> None:
    """As the fuzzer compares them; whole frames, lengths and zeros get further than bytes at random."""
    fuzz_simulator(
        bytes((framing is Framing.LENGTH_PREFIXED,))
        + b"".join(bytes((pause, len(data))) + data for pause, data in sent)
    )


# ---- memory corruption


@pytest.mark.parametrize("servo_id", [0, 1, 2, 3, 10])
@pytest.mark.parametrize("op", [1, 2, 3])
def test_entries_252_to_255_kill_the_published_firmware_until_it_is_reset(
    prefixed: Bench, servo_id: int, op: int
) -> None:
    prefixed.send(START_LEG_1)
    prefixed.send(bytes((6, 2, servo_id, op, 90, 0)))
    assert prefixed.controller.dead == f"servo id {servo_id} with operation {op} is a bus fault"
    prefixed.now_ns += 2_000 * MS
    prefixed.send(bytes((14, 1, 11, 2, 0, 0, 12, 2, 0, 0, 13, 2, 0, 0)))
    assert prefixed.controller.energised == {11, 12, 13}, "nothing stops it any more"
    prefixed.controller.reset()
    assert prefixed.controller.energised == set()
    prefixed.send(START_LEG_1)
    assert prefixed.controller.energised == {11, 12, 13}


def test_of_256_ids_these_five_kill_and_no_other(plain: Bench) -> None:
    died = set()
    for servo_id in range(256):
        frame = bytes((6, 2, servo_id, 1, 90, 0))
        bench = Bench(Framing.LENGTH_PREFIXED)
        bench.send(frame)
        plain.send(frame)
        if bench.controller.dead is not None:
            died.add(servo_id)
    assert died == {0, 1, 2, 3, 10}
    assert plain.controller.dead is None


@pytest.mark.parametrize("length", [64, 65, 68])
def test_lengths_up_to_68_do_no_harm(prefixed: Bench, length: int) -> None:
    prefixed.transfer(bytes((length,)), bytes(length))
    assert prefixed.controller.dead is None
    assert prefixed.controller.missing == 0
    prefixed.send(START_11)
    assert prefixed.controller.energised == {11}


@pytest.mark.parametrize("length", [69, 90, 255])
def test_lengths_of_69_to_255_leave_it_deaf_for_good_once_68_bytes_have_come(prefixed: Bench, length: int) -> None:
    """Two bare frames announce 90 bytes, which its timeout still ends; fifteen are too many."""
    prefixed.send(START_11)
    prefixed.transfer(bytes((length,)))
    prefixed.transfer(bytes(68))
    assert prefixed.controller.dead is None
    prefixed.transfer(b"\0")
    assert prefixed.controller.dead == "69 bytes in a buffer of 64 overwrote its SPI handle"
    prefixed.now_ns += 5_000 * MS
    prefixed.send(STOP_11)
    assert prefixed.controller.energised == {11}


def test_five_bytes_lost_of_leg_3_start_a_servo_that_nobody_started(prefixed: Bench) -> None:
    """`0e 01`, which announces and begins leg 4's Set, is taken for id 14 with operation Start."""
    sets = [OneLeg(leg, (ServoOp(Op.SET, 90_00),) * 3).to_bytes() for leg in (3, 4)]
    prefixed.send(*[OneLeg(leg, (ServoOp(Op.START, 90_00),) * 3).to_bytes() for leg in (3, 4)])
    stream = b"".join(on_wire(Framing.LENGTH_PREFIXED, *sets))
    started: set[int] = set()
    for first in range(len(stream) // 2 - 5 + 1):
        bench = Bench(Framing.LENGTH_PREFIXED)
        bench.transfer(stream[:first] + stream[first + 5 :])
        started |= bench.controller.energised
    assert started == {21}
