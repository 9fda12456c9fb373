"""How frames are cut into transfers."""

import pytest
from hypothesis import given

from gateway.robot.protocol.frames import Frame
from gateway.robot.protocol.framing import Framing, avoided_by
from tests.unit.robot.test_frames import frames


def test_the_names_of_the_configuration() -> None:
    assert [framing.value for framing in Framing] == ["plain", "length-prefixed"]
    assert Framing("plain") is Framing.PLAIN
    with pytest.raises(ValueError, match="prefixed"):
        Framing("prefixed")


def test_only_length_prefixed_has_a_preamble() -> None:
    assert Framing.PLAIN.preamble == ()
    assert Framing.LENGTH_PREFIXED.preamble == (b"\0",) * 16, "each in a transfer of its own"


def test_angles_of_which_the_published_firmware_can_die() -> None:
    """One to, without, four degrees: its ids 1 to 3 with operations 1 to 3 (tests/deaf)."""
    assert (Framing.PLAIN.avoid_cdeg, Framing.LENGTH_PREFIXED.avoid_cdeg) == (None, (100, 400))
    assert [avoided_by(name) for name in ("plain", "length-prefixed", "of a later version")] == [None, (100, 400), None]


@given(frames)
def test_the_last_transfer_is_the_frame_itself(frame: Frame) -> None:
    for framing in Framing:
        *announcements, last = framing.transfers(frame.to_bytes())
        assert last == frame.to_bytes()
        assert announcements == ([] if framing is Framing.PLAIN else [bytes((len(last),))])
