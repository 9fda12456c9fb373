"""A message costs no more Python calls than it did: figures that are the same on every machine."""

from pathlib import Path

from tests.support.calls import Cost, costs

HELD = {
    "a stream's six legs": Cost(140, 246),
    "an acked leg": Cost(85, 127),
    "a leg": Cost(80, 110),
    "a walk's six legs": Cost(149, 255),
    "an emergency stop": Cost(144, 258),
}
"""What Python 3.11 takes, to the call; later ones take fewer, since they inline comprehensions."""


def test_no_message_takes_more_calls_than_it_did(tmp_path: Path) -> None:
    found, _ = costs(tmp_path)
    assert found.keys() == HELD.keys()
    more = {name: cost for name, cost in found.items() if any(map(int.__gt__, cost, HELD[name]))}
    assert not more, "each is held to what it takes, and to no more"
