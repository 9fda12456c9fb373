"""The journal's texts: what they contain, that they decide the same, and what a version that does not know them says.

`test_supervisor_machine.py` decides random runs again, with random rules.
"""

import random
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

import pytest
from pydantic import BaseModel
from pydantic_core import from_json, to_json

from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.model.frames import SETS, STARTS, STOP, Op, ServoOp
from gateway.robot.blackbox import journal
from gateway.robot.core import events
from gateway.robot.core.events import BusOpened, Command, LeaseRequest, Rejected
from gateway.robot.core.message import Verb
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import ALL_EVENTS, Supervisor
from schemas.calibration import CalibrationCommand, ServoChange
from schemas.words import Kind, Reason
from tests.support.history import frames_of, numbered
from tests.support.model_check import State, candidates
from tests.support.oracle import Oracle
from tests.support.small_robots import CONFIGURATIONS, Configuration
from tests.support.transitions import TRANSITIONS

RANDOM = "0123456789abcdef"
MASKED = journal.token_text(journal.token_number(RANDOM))


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
        assert MASKED.encode() in text


def test_a_tokens_number_has_32_bits_and_is_not_that_of_another() -> None:
    numbers = {journal.token_number(f"token {number}") for number in range(1000)}
    assert len(numbers) == 1000
    assert 2**31 < max(numbers) < 2**32
    assert (journal.token_text(10), journal.token_text(2**32 - 1)) == ("0000000a", "ffffffff")


def test_a_restored_supervisor_has_the_same_keyframe() -> None:
    supervisor = journal.restored(keyframe())
    lease = {"_token": supervisor.lease._token}
    again = from_json(journal.Keyframes(supervisor).take())
    again["state"]["lease."] |= lease  # its own tokens are masked once more
    assert again == from_json(keyframe())


def test_a_keyframe_has_what_differs_from_a_new_supervisor() -> None:
    found = from_json(keyframe())
    assert (found["format"], found["rules"]) == (1, {"Rules": {}})
    assert found["state"]["lease."] == {
        "holder": "anna", "_token": MASKED, "since_ns": 2, "due_ns": 1_000_000_002, "closed": True,
    }  # fmt: skip
    assert found["state"]["legs."] == {"sends": True, "stopped_ns": 1, "instant_ns": 2, "due_ns": 20_000_001}
    assert found["state"]["legs.servos.11."] == {
        "stopped_ns": 1, "stopped_by": {"frozenset": [{"Cause": "startup"}]},
    }  # fmt: skip


# ---- events


CALIBRATION = CalibrationCommand(
    servos={"11": ServoChange(trim_deg=-10.0, inverted=True, max_deg=15.0)},
    landing={"11": None, "62": 50.0},
    revision=3,
)
EVENTS: Mapping[str, events.Event] = {
    "opened": BusOpened(),
    "failed": events.BusFailed("no answer", Kind.CONTROLLER_SILENT),
    "failed as most": events.BusFailed("no answer"),
    "command": Command(
        ((11, STARTS[90_25]), (12, STOP), (13, SETS[0])), key="hexapod/leg/1/cmd", source="anna", source_id="a1",
        sent_ms=12.5, verb=Verb.GET, received_ns=5, number=7, lease=RANDOM, lost=True,
    ),
    "reset": events.Reset(key="hexapod/reset", source="anna", number=3, estop=4, lease=RANDOM),
    "calibrate": events.Calibrate(key="k", number=9, change=CALIBRATION),
    "saved": events.CalibrationSaved(9, "the disk is full"),
    "outside": events.StoppedOutside(at_work=True),
    "kept": events.EstopKept(4, engaged=True),
    "stop": events.EmergencyStop("anna", "hexapod/estop", "a1"),
    "lease": LeaseRequest("release", "anna", RANDOM, "ben", "", "a1"),
    "button": events.ButtonRequest("alive", 5, "anna", "cert", False, RANDOM, 3, 1.5, RANDOM, "a1"),
    "body": events.BodyMeasured(None, 7_200),
    "power": events.PowerSeen(
        True, ((11, "over"), (12, "under")), frozenset({11, 12}), frozenset({13}), "doubt", frozenset({13}),
        frozenset({11}), ((21, "draws"),), True,
    ),
    "time": events.TimePassed(),
    "end": events.ShutDown(),
}  # fmt: skip
TEXTS: Mapping[str, Any] = {
    "opened": {"BusOpened": {}},
    "failed": {"BusFailed": {"detail": "no answer", "kind": {"Kind": "controller_silent"}}},
    "failed as most": {"BusFailed": {"detail": "no answer"}},
    "command": {
        "Command": {
            "targets": [[11, {"ServoOp": [1, 90_25]}], [12, {"ServoOp": [2, 0]}], [13, {"ServoOp": [3, 0]}]],
            "key": "hexapod/leg/1/cmd", "source": "anna", "source_id": "a1", "sent_ms": 12.5, "lease": MASKED,
            "verb": {"Verb": "get"}, "received_ns": 5, "number": 7, "lost": True,
        }
    },
    "calibrate": {
        "Calibrate": {
            "key": "k", "number": 9,
            "change": {
                "CalibrationCommand": {
                    "source": None, "sent_ms": None, "lease": None,
                    "revision": 3,
                    "servos": {"dict": [["11", {
                        "ServoChange": {"trim_deg": -10.0, "inverted": True, "min_deg": None, "max_deg": 15.0},
                    }]]},
                    "landing": {"dict": [["11", None], ["62", 50.0]]},
                    "accept_default": None,
                }
            },
        }
    },
    "body": {"BodyMeasured": {"tilt_cdeg": None, "battery_mv": 7_200}},
    "time": {"TimePassed": {}},
}  # fmt: skip


def shape(value: Any) -> Any:
    """Return a value as plain types, which compare by content."""
    if isinstance(value, tuple):
        return tuple, [shape(each) for each in value]
    if isinstance(value, BaseModel):
        return type(value), {name: shape(each) for name, each in value}
    if isinstance(value, dict):
        return {key: shape(each) for key, each in value.items()}
    if is_dataclass(value) and type(value) is not ServoOp:
        names = [each.name for each in fields(value) if each.name != "frames"]
        return type(value), {name: shape(getattr(value, name)) for name in names}
    return type(value), value


@pytest.mark.parametrize("name", EVENTS)
def test_an_event_is_read_as_it_was(name: str) -> None:
    assert {type(event) for event in EVENTS.values()} == ALL_EVENTS
    event = EVENTS[name]
    plain = from_json(to_json(journal.plain_event(event)))
    secrets: dict[str, Any] = {each: MASKED for each in journal.SECRETS if getattr(event, each, None)}
    assert shape(journal.event_of(plain)) == shape(replace(event, **secrets))
    assert plain == TEXTS.get(name, plain)


def test_an_event_is_read_as_it_was_before_its_step() -> None:
    targets = ((11, SETS[90_00]),)
    command = Command(targets, frames=frames_of(targets), key="hexapod/servo/11/cmd", number=7)
    command.rejected = Rejected(command, Reason.STALE, "too old")
    command.left, command.coalesced, command.written, command.stopped = 0, True, (1,), (11,)
    command.reply = lambda _: None
    plain = journal.plain_event(command)
    assert plain["Command"]["rejected"] == {"Rejected": {
        "request": {"Command": 0}, "reason": {"Reason": "stale"}, "detail": "too old",
    }}  # fmt: skip
    read = journal.event_of(plain)
    assert isinstance(read, Command)
    assert (read.targets, read.by_leg, read.moves) == (command.targets, command.by_leg, command.moves)
    assert (read.left, read.coalesced, read.written, read.number) == (1, False, (), 7)
    assert (read.stopped, read.reply, read.frames) == ((), None, ())
    assert read.rejected is not None
    assert read.rejected.request is read


def test_the_rejection_of_an_unreadable_message_answers_another_request() -> None:
    command = Command(((11, STOP),), number=7)
    command.rejected = Rejected(events.Request(key="k", number=7), Reason.MALFORMED, "no JSON")
    read = journal.event_of(from_json(to_json(journal.plain_event(command))))
    assert isinstance(read, Command)
    assert read.rejected is not None
    assert type(read.rejected.request) is events.Request
    assert read.rejected.request.key == "k"


def test_operations_are_those_that_the_core_has() -> None:
    targets = ((11, STARTS[90_25]), (12, STOP), (13, SETS[45_00]))
    read = journal.event_of(journal.plain_event(Command(targets)))
    assert isinstance(read, Command)
    assert [op for _, op in read.targets] == [ServoOp(Op.START, 90_25), ServoOp(Op.STOP), ServoOp(Op.SET, 45_00)]
    assert all(op is before for (_, op), (_, before) in zip(read.targets, targets, strict=True))


def test_a_tokens_mask_can_be_left_out() -> None:
    event = LeaseRequest("renew", token=RANDOM)
    assert journal.plain_event(event, mask=lambda token: token) == {"LeaseRequest": {"do": "renew", "token": RANDOM}}
    assert journal.masked({RANDOM: 5, "": 6, None: 7}) == {MASKED: 5, "": 6, None: 7}


# ---- a run is decided again


def with_the_journals_token(effect: events.Effect) -> events.Effect:
    if not isinstance(effect, events.RequestAnswer) or effect.token is None:
        return effect
    return replace(effect, token=journal.masked(effect.token))


@pytest.mark.parametrize("configuration", CONFIGURATIONS, ids=lambda each: each.name)
def test_a_run_is_decided_again_from_any_of_its_steps(configuration: Configuration) -> None:
    chance = random.Random(configuration.name)  # noqa: S311  (order, no secrets)
    supervisor = Supervisor(configuration.rules)
    kept = configuration.calibration or RobotCalibration()
    supervisor.calibrating.load(kept, configuration.fault)
    oracle = Oracle(configuration.rules, calibration=kept, fault=configuration.fault)
    keyframes, now_ns, frames = journal.Keyframes(supervisor), 1000, 0
    played = journal.restored(keyframes.take())
    for number in range(1, 200):
        state = State(supervisor, oracle, now_ns, now_ns, number)
        found = [
            event for _, event in candidates(configuration, state, now_ns)
            if type(event) in TRANSITIONS[supervisor.mode]
        ]  # fmt: skip
        kinds = {type(event): event for event in chance.sample(found, len(found))}
        event = kinds.get(BusOpened) if number == 1 or chance.random() < 0.1 else None
        event = event or chance.choice([*kinds.values(), *[kinds[Command]] * 3 * (Command in kinds)])
        now_ns += chance.choice(configuration.waits_ns)
        effects = supervisor.step(event, now_ns)
        oracle.judge(event, now_ns, effects, supervisor, now_ns)
        read = journal.event_of(from_json(to_json(journal.plain_event(event))))
        again = played.step(read, now_ns)
        assert list(map(numbered, again)) == [numbered(with_the_journals_token(each)) for each in effects]
        assert journal.frames_of(again) == journal.frames_of(effects)
        frames += len(journal.frames_of(effects))
        played = journal.restored(keyframes.take()) if number % 3 == 0 else played
    assert frames > 20


def test_frames_are_those_of_a_step_in_their_order() -> None:
    supervisor = Supervisor(Rules())
    frames = journal.frames_of(supervisor.step(BusOpened(), 1))
    assert [frame[:6] for frame in frames] == ["0e010b", "0e0115", "0e011f", "0e0129", "0e0133", "0e013d"]


def test_a_keyframe_may_be_restored_with_other_rules() -> None:
    rules = Rules(timeout_ns=7, joint_limits_cdeg={11: (1, 2)})
    supervisor = Supervisor(rules)
    kept = RobotCalibration(5, {11: ServoMapping(-10_00, inverted=True)}, {})
    supervisor.calibrating.load(kept, None)
    found = journal.restored(journal.Keyframes(supervisor).take().decode(), lambda each: replace(each, timeout_ns=9))
    assert found._rules == replace(rules, timeout_ns=9)
    assert found.legs.limits.calibration == kept
    assert found.legs.limits.wire == kept
    assert found.calibrating.in_force is found.legs.limits.calibration


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
