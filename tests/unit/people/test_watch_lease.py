"""Who is driving, in `watch`: the top line, and the questions behind its keys."""

import pytest

from gateway.people.tools.watch.model import QUESTION_NS, Model, Tone
from schemas.telemetry import ButtonsReport, LeaseReport, Mode
from tests.support.watch_reports import WALL, screen, state

ANNA = LeaseReport(holder="anna", verified=True, held_s=12.3, expires_in_ms=800)


def driven(lease: LeaseReport, mode: Mode = Mode.ACTIVE) -> Model:
    model = Model()
    model.received_state(state(mode=mode, running=True).model_copy(update={"lease": lease}), 0, WALL)
    return model


@pytest.mark.parametrize(
    ("lease", "shown"),
    [
        (LeaseReport(), " ACTIVE   1 leg running  tcp/robot:7447"),
        (ANNA, " ACTIVE   1 leg running  anna drives  tcp/robot:7447"),
        (ANNA.model_copy(update={"asked_by": "bert"}), "  anna drives, bert asks  tcp/robot:7447"),
        (ANNA.model_copy(update={"verified": False}), "  anna? drives  "),
        (ANNA.model_copy(update={"held_s": None, "holder": "bert"}), "  handed to bert  "),
        (ANNA.model_copy(update={"holder": "x\x1b[2J" + "y" * 60}), "  x�[2Jyyyyyyyy… drives  "),
    ],
)
def test_the_top_line_says_who_drives(lease: LeaseReport, shown: str) -> None:
    assert shown in screen(driven(lease)).splitlines()[0]


@pytest.mark.parametrize(
    ("buttons", "shown"),
    [
        (ButtonsReport(), " ACTIVE   1 leg running  tcp/robot:7447"),
        (ButtonsReport(required=1, alive=2, names=("kitchen", "door")), "1 leg running  buttons 2/1  tcp/robot:7447"),
        (ButtonsReport(required=2, alive=1, names=("kitchen",)), "1 leg running  buttons 1/2  tcp/robot:7447"),
    ],
)
def test_the_top_line_says_how_many_watch(buttons: ButtonsReport, shown: str) -> None:
    model = Model()
    model.received_state(state(mode=Mode.ACTIVE, running=True).model_copy(update={"buttons": buttons}), 0, WALL)
    assert shown in screen(model).splitlines()[0]


def test_to_take_it_is_asked_back_with_the_name_and_what_it_does() -> None:
    model = driven(ANNA, Mode.ESTOPPED)
    assert model.take_question(0) is None
    model.take_pressed(0)
    assert "Take it from anna? All six legs stop first. y: yes n: no" in screen(model)
    assert not model.asking(0), "a y answers one question only"
    model.reset_pressed(1)
    assert model.take_question(1) is None


def test_where_nobody_drives_the_question_says_what_it_means_for_others() -> None:
    model = driven(LeaseReport())
    model.take_pressed(0)
    assert "Drive? Nobody else's starts, sets and resets count then" in screen(model)


def test_the_question_does_not_stand_for_ever_and_a_stop_takes_it_back() -> None:
    model = driven(ANNA)
    model.take_pressed(0)
    model.look(QUESTION_NS, WALL)
    assert not model.asking_to_take(0)
    model.take_pressed(0)
    model.stop_pressed(1)
    assert not model.asking_to_take(1)


def test_what_became_of_it() -> None:
    model = driven(ANNA)
    model.take_pressed(0)
    model.take_declined(1)
    assert model.remark is not None
    assert (model.remark.text, model.take_question(1)) == ("not taken", None)
    model.take_confirmed(2)
    model.lease_answered(None, "you drive", 3)
    assert (model.remark.tone, model.remark.text) == (Tone.GOOD, "you drive")
    model.lease_answered("NOT DONE: lease_denied: no\x1b", "", 4)
    assert (model.remark.tone, model.remark.text) == (Tone.BAD, "NOT DONE: lease_denied: no�")


def test_the_keys_stand_on_the_last_line() -> None:
    last = screen(driven(ANNA)).splitlines()[-1]
    assert last == " SPACE or e: EMERGENCY STOP   r: reset  q: quit  a: ask  t: take  (● on  ○ off)"
