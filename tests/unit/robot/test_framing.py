"""How frames are cut into transfers."""

import pytest
from hypothesis import given

from gateway.robot.protocol.frames import Frame, stop_leg
from gateway.robot.protocol.framing import Framing, avoided_by
from tests.unit.robot.test_frames import frames


def test_the_names_of_the_configuration() -> None:
    assert [framing.value for framing in Framing] == ["plain", "length-prefixed"]
    assert Framing("plain") is Framing.PLAIN
    with pytest.raises(ValueError, match="prefixed"):
        Framing("prefixed")


def test_plain_is_one_transfer() -> None:
    frame = bytes.fromhex("06 02 20 02 00 00")
    assert Framing.PLAIN.transfers(frame) == (frame,)


def test_the_length_goes_ahead_in_a_transfer_of_its_own() -> None:
    frame = stop_leg(1).to_bytes()
    assert Framing.LENGTH_PREFIXED.transfers(frame) == (b"\x0e", frame)


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
