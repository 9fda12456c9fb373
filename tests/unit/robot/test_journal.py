"""The journal's texts: what they contain, and what a version that does not know them says.

`test_supervisor_machine.py` shows that a run that is decided again has the same effects.
"""

from typing import Any

import pytest
from pydantic_core import from_json, to_json

from gateway.model.frames import SETS
from gateway.robot.blackbox import journal
from gateway.robot.core.events import BusOpened, Command, LeaseRequest, Rejected
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import Supervisor
from schemas.telemetry import Reason

RANDOM = "0123456789abcdef"


def keyframe(**changes: Any) -> bytes:
    supervisor = Supervisor(Rules())
    keyframes = journal.Keyframes(supervisor)
    supervisor.step(BusOpened(), 1)
    supervisor.step(LeaseRequest("acquire", "anna", fresh_token=RANDOM), 2)
    return to_json(from_json(keyframes.take()) | changes)


def test_a_token_is_not_in_the_journal() -> None:
    event = LeaseRequest("acquire", "anna", fresh_token=RANDOM)
    for text in (keyframe(), to_json(journal.plain_event(event))):
        assert RANDOM.encode() not in text
        assert journal.token_text(journal.token_number(RANDOM)).encode() in text


def test_a_restored_supervisor_has_the_same_keyframe() -> None:
    supervisor = journal.restored(keyframe())
    lease = {"_token": supervisor.lease._token}
    again = from_json(journal.Keyframes(supervisor).take())
    again["state"]["lease."] |= lease  # its own tokens are masked once more
    assert again == from_json(keyframe())


def test_an_event_is_read_as_it_was_before_its_step() -> None:
    command = Command(((11, SETS[90_00]),), key="hexapod/servo/11/cmd", number=7)
    command.rejected = Rejected(command, Reason.STALE, "too old")
    command.left, command.coalesced, command.written = 0, True, (1,)
    read = journal.event_of(journal.plain_event(command))
    assert isinstance(read, Command)
    assert (read.targets, read.by_leg, read.moves) == (command.targets, command.by_leg, command.moves)
    assert (read.left, read.coalesced, read.written, read.number) == (1, False, (), 7)
    assert read.rejected is not None
    assert read.rejected.request is read


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"format": 2}, "its format is 2, and this version reads 1"),
        ({"state": {"legs.": {"mood": 1}}}, "its keyframe has legs.mood, which this version does not know"),
        ({"state": {"tail.": {"sends": True}}}, "its keyframe has tail.sends, which this version does not know"),
        ({"rules": {"Rules": {"mood": 1}}}, "its Rules has mood, which this version does not know"),
        ({"state": {"": {"mode": {"Mood": 1}}}}, "it has a Mood, which this version does not know"),
    ],
)
def test_what_this_version_does_not_know_has_a_sentence(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(journal.JournalError, match=sentence):
        journal.restored(keyframe(**changes))


def test_an_unknown_event_has_a_sentence() -> None:
    with pytest.raises(journal.JournalError, match="it has a Rules in place of an event"):
        journal.event_of({"Rules": {}})
