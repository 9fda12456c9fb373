"""The bytes of one scene are those that were recorded; see `tests/support/scene_bytes.py`."""

import pytest

from gateway.model.frames import Framing
from tests.support.scene_bytes import path, transfers


@pytest.mark.parametrize("framing", Framing)
def test_the_bytes_of_a_scene_are_those_that_were_recorded(framing: Framing) -> None:
    assert transfers(framing) == path(framing).read_text().splitlines()


def test_where_a_kernel_takes_no_lists_they_are_the_same() -> None:
    """In `plain`; zeros that are written one by one take time here."""
    assert transfers(Framing.PLAIN, lists=False) == path(Framing.PLAIN).read_text().splitlines()
