"""The bytes of one scene are those that were recorded; see `tests/support/scene_bytes.py`."""

import pytest

from gateway.model.framing import Framing
from tests.support.scene_bytes import path, transfers


@pytest.mark.parametrize("framing", Framing)
def test_the_bytes_of_a_scene_are_those_that_were_recorded(framing: Framing) -> None:
    assert transfers(framing) == path(framing).read_text().splitlines()


def test_without_batches_they_are_the_same() -> None:
    """In `plain`; the zeros take time here without batches alone. For both framings: `hil/test_lists.py`."""
    assert transfers(Framing.PLAIN, batch=False) == path(Framing.PLAIN).read_text().splitlines()
