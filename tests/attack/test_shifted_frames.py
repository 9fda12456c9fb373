"""A byte that is lost or doubled in any legal frame: does the published firmware die of it?"""

from itertools import product

import pytest

from gateway.model.frames import OneLeg, OneServo, Op, ServoOp
from gateway.model.framing import Framing
from gateway.robot.spi.simulator import SimulatedController
from tests.deaf.shifts import HARMLESS_LEN, KILLS, OPERATIONS, commands, faults, lost_and_doubled, neighbours, worst
from tests.support.transfers import on_wire

AVOID = Framing.LENGTH_PREFIXED.avoid_cdeg
ALL_FAULTS = [(servos, what, stream) for servos in (1, 3) for what, stream in faults(servos)]


def test_no_legal_frame_with_one_byte_lost_or_doubled_has_an_id_that_kills() -> None:
    assert AVOID == (1_00, 4_00)
    found = {what: worst(stream, AVOID).killing for _, what, stream in ALL_FAULTS}
    assert len(ALL_FAULTS) == 2 * (7 + 15)
    assert not any(found.values()), found


def test_wherever_the_firmware_begins_to_read_two_bytes_of_one_angle_kill_and_no_others() -> None:
    """A record's id and operation are neighbours on the wire: 0.01 to 0.03 and 10.01 to 10.03 degrees remain.

    It takes more than one lost byte to read them so, as the next test does.
    """
    found = {pairs: pairs & KILLS for pairs in neighbours(AVOID) if pairs & KILLS}
    assert set().union(*found.values()) == set(product((0, 10), OPERATIONS))
    angles = {(whole_deg, hundredths) for _, whole_deg, hundredths in commands(AVOID)}
    assert all(pairs <= angles for pairs in found)


@pytest.mark.parametrize("angle_cdeg", [2, 10_02])
def test_two_lost_bytes_may_kill_by_an_id_where_one_does_not(angle_cdeg: int) -> None:
    frame = OneLeg(3, (ServoOp(Op.SET, angle_cdeg), ServoOp(Op.SET, 90_00), ServoOp(Op.SET, 90_00)))
    data = b"".join(on_wire(Framing.LENGTH_PREFIXED, frame))
    died = {}
    for lost in (1, 2):
        for at in range(len(data)):
            controller = SimulatedController(Framing.LENGTH_PREFIXED, clock=lambda: 0)
            controller.take(data[:at] + data[at + lost :] + b"\x0e\x0e")
            if controller.dead is not None:
                died[lost] = controller.dead
    assert died == {2: f"servo id {angle_cdeg // 100} with operation 2 is a bus fault"}


def test_what_remains_is_a_doubled_byte_that_pushes_out_hundredths_of_69_to_99() -> None:
    lengths = {what: worst(stream, AVOID).lengths for _, what, stream in ALL_FAULTS}
    assert all(lengths[what] == frozenset(range(100)) for what in lengths if what.endswith("doubled"))
    assert not any(lengths[what] for what in lengths if what.endswith("lost"))
    assert max(range(100)) > HARMLESS_LEN


@pytest.mark.parametrize(
    ("avoid_cdeg", "deadly"), [(None, True), ((1_00, 3_00), True), ((1_01, 4_00), True), ((1_00, 4_00), False)]
)
def test_without_the_limit_or_with_a_narrower_one_it_does(avoid_cdeg: tuple[int, int] | None, deadly: bool) -> None:
    """So the search finds what there is, and the interval is no wider than it must be."""
    found = [what for _, what, stream in ALL_FAULTS if worst(stream, avoid_cdeg).killing]
    assert bool(found) is deadly
    assert not [what for what in found if what.endswith("doubled")]


@pytest.mark.parametrize("whole_deg", [0, 1, 2, 3, 4, 10, 90])
@pytest.mark.parametrize("op", [Op.START, Op.SET])
def test_the_simulated_controller_dies_of_what_the_rule_says(op: Op, whole_deg: int) -> None:
    """Of each frame with such an angle, each byte lost and doubled, and the next frame behind it."""
    command, other = ServoOp(op, 100 * whole_deg + 50), ServoOp(Op.SET, 90_00)
    frames: list[OneLeg | OneServo] = [
        OneServo(32, command),
        OneLeg(3, (command, other, other)),
        OneLeg(3, (other, other, command)),
    ]
    for frame in frames:
        died = set()
        for what, data in lost_and_doubled(frame):
            controller = SimulatedController(Framing.LENGTH_PREFIXED, clock=lambda: 0)
            controller.take(data)
            controller.take(b"\x0e")
            if controller.dead is not None:
                died.add(what)
        assert bool(died) is (whole_deg in OPERATIONS), (frame, died)
