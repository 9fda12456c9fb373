"""The two framings: their names, and the angles that they avoid."""

import pytest

from gateway.model.framing import Framing, avoided_by


def test_the_names_of_the_configuration() -> None:
    assert [framing.value for framing in Framing] == ["plain", "length-prefixed"]
    assert Framing("plain") is Framing.PLAIN
    assert ["STM32" in framing.controller for framing in Framing] == [False, True]
    with pytest.raises(ValueError, match="prefixed"):
        Framing("prefixed")


def test_angles_of_which_the_published_firmware_can_die() -> None:
    """One to, without, four degrees: its ids 1 to 3 with operations 1 to 3 (tests/deaf)."""
    assert (Framing.PLAIN.avoid_cdeg, Framing.LENGTH_PREFIXED.avoid_cdeg) == (None, (100, 400))
    assert [avoided_by(name) for name in ("plain", "length-prefixed", "of a later version")] == [None, (100, 400), None]


def test_how_fast_each_takes_its_bytes() -> None:
    plain, prefixed = Framing.PLAIN, Framing.LENGTH_PREFIXED
    assert (plain.most_hz, plain.least_gap_us) == (20_000_000, 0.0)
    assert (prefixed.most_hz, prefixed.least_gap_us) == (5_000_000, 20.0)
    assert prefixed.too_fast(5_000_000, 20.0) == ""
    assert "5000001" in prefixed.too_fast(5_000_001, 20.0)
    assert "19.9" in prefixed.too_fast(5_000_000, 19.9)
    assert plain.too_fast(20_000_000, 0.0) == ""
