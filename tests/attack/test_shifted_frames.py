"""A byte that is lost or doubled in any legal frame: does the published firmware die of it?"""

from itertools import product

from gateway.model.framing import Framing
from tests.deaf.shifts import KILLS, OPERATIONS, commands, faults, neighbours, worst

AVOID = Framing.LENGTH_PREFIXED.avoid_cdeg
ALL_FAULTS = [(servos, what, stream) for servos in (1, 3) for what, stream in faults(servos)]


def test_no_legal_frame_with_one_byte_lost_or_doubled_has_an_id_that_kills() -> None:
    assert AVOID == (1_00, 4_00)
    found = {what: worst(stream, AVOID) for _, what, stream in ALL_FAULTS}
    assert len(ALL_FAULTS) == 2 * (7 + 15)
    assert not any(found.values()), found


def test_wherever_the_firmware_begins_to_read_two_bytes_of_one_angle_kill_and_no_others() -> None:
    """A record's id and operation are neighbours on the wire: 0.01 to 0.03 and 10.01 to 10.03 degrees remain.

    It takes more than one lost byte to read them so: tests/unit/robot/test_simulator.py.
    """
    found = {pairs: pairs & KILLS for pairs in neighbours(AVOID) if pairs & KILLS}
    assert set().union(*found.values()) == set(product((0, 10), OPERATIONS))
    angles = {(whole_deg, hundredths) for _, whole_deg, hundredths in commands(AVOID)}
    assert all(pairs <= angles for pairs in found)
