"""A byte that is lost or doubled in any legal frame: does the published firmware die of it?"""

from gateway.model.frames import Framing
from tests.deaf.shifts import faults, worst

AVOID = Framing.LENGTH_PREFIXED.avoid_cdeg
ALL_FAULTS = [(servos, what, stream) for servos in (1, 3) for what, stream in faults(servos)]


def test_no_legal_frame_with_one_byte_lost_or_doubled_has_an_id_that_kills() -> None:
    assert AVOID == (1_00, 4_00)
    found = {what: worst(stream, AVOID) for _, what, stream in ALL_FAULTS}
    assert len(ALL_FAULTS) == 2 * (7 + 15)
    assert not any(found.values()), found
    assert any(worst(stream, None) for _, _, stream in ALL_FAULTS), "were it not for the angles that are never sent"
