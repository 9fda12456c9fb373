"""What `watch` knows: its model, with the time as an argument, and the words for it on the screen."""

import pytest

from gateway.allowance import NS_PER_S
from gateway.people.terminal.stop_status import Tone
from gateway.people.tools.watch.model import (
    COUNTED_SOURCES,
    OTHERS,
    QUESTION_NS,
    SILENT_AFTER_NS,
    Confirmation,
    Counts,
    Model,
    WatchedPresence,
)
from gateway.robot.core.rejection_limit import RejectionLimit
from schemas.telemetry import Ack, ButtonsReport, Kind, LeaseReport, Mode, Reason, WatchdogState
from tests.support.watch_reports import NS_PER_MS, WALL, event, kinds, model_with_state, rejected, screen, state

STOPPED = Ack(accepted=True, stop_frames=6, latency_us=812.4)


# ---- is anybody there?


def test_nothing_has_been_received() -> None:
    model = Model(trouble="no gateway answers on tcp/robot:7447")
    assert model.presence(0) is WatchedPresence.WAITING
    assert " WAITING " in screen(model)
    assert "no gateway answers on tcp/robot:7447" in screen(model)
    assert "trying again" in screen(model)


def test_silence_begins_after_its_time_and_ends_with_the_first_word() -> None:
    model = Model()
    model.received_state(state(), 0, WALL)
    assert model.presence(SILENT_AFTER_NS) is WatchedPresence.LIVE
    assert model.presence(SILENT_AFTER_NS + 1) is WatchedPresence.SILENT
    model.look(SILENT_AFTER_NS + 1, WALL)
    model.look(SILENT_AFTER_NS + 2, WALL)
    assert kinds(model) == ["silent"]
    assert "SILENT for 4.0 s" in screen(model, 4 * NS_PER_S)
    assert "was IDLE" in screen(model, 4 * NS_PER_S)
    assert "If the robot moves, cut power" in screen(model, 4 * NS_PER_S)
    model.received_state(state(14), 4 * NS_PER_S, WALL)
    assert model.presence(4 * NS_PER_S) is WatchedPresence.LIVE
    assert kinds(model) == ["back", "silent"]
    assert model.lines[0].text == "the gateway publishes again, after 4.0 s"
    model.received_event(event(Kind.WATCHDOG_EXPIRED), 5 * NS_PER_S, WALL)
    assert model.presence(SILENT_AFTER_NS + 5 * NS_PER_S) is WatchedPresence.LIVE, "an event alone is a word, too"


def test_a_token_that_goes_is_silence_at_once() -> None:
    model = Model()
    model.received_token(True, 0, WALL)
    assert model.presence(0) is WatchedPresence.LIVE
    model.received_token(False, NS_PER_MS, WALL)
    assert model.presence(NS_PER_MS) is WatchedPresence.SILENT
    assert kinds(model) == ["silent"]
    model.received_token(True, 2 * NS_PER_MS, WALL)
    assert model.presence(2 * NS_PER_MS) is WatchedPresence.LIVE


@pytest.mark.parametrize("uptime_s", [100, 0.6])
def test_a_gateway_that_was_started_anew_is_noticed(uptime_s: float) -> None:
    model = Model()
    model.received_state(state(uptime_s, counts=(50, 0, 0), frames=6), 0, WALL)
    model.received_state(state(0.5, frames=6, started_s=uptime_s + 0.5), NS_PER_S, WALL)
    assert kinds(model) == ["restarted"]
    assert model.rates() is None
    model.received_state(state(1.5, counts=(10, 0, 0), frames=16, started_s=uptime_s + 0.5), 2 * NS_PER_S, WALL)
    assert kinds(model) == ["restarted"]
    assert model.rates() == Counts(10, 0, 0, 10)


def test_others_that_answer_are_reported_once() -> None:
    model = Model()
    for _ in range(3):
        model.note_others("2 programs answer", WALL)
    assert kinds(model) == ["others_answer"]


def test_an_answer_that_was_overtaken_changes_nothing() -> None:
    model = Model()
    model.received_state(state(10.0, Mode.IDLE, frames=5), 0, WALL)
    model.received_state(state(10.2, Mode.ESTOPPED, frames=11), NS_PER_MS, WALL)
    model.received_state(state(10.1, Mode.IDLE, frames=5), 2 * NS_PER_MS, WALL)
    assert model.state is not None
    assert model.state.mode is Mode.ESTOPPED
    assert kinds(model) == []


# ---- how old is what I see?


def test_the_age_of_a_command_grows_between_two_states() -> None:
    model = Model()
    heard = state(age_ms=40, watchdog=WatchdogState.ARMED, running=True)
    model.received_state(heard, 0, WALL)
    assert model.command_age_ms(heard.legs[2], 0) == 40
    assert model.command_age_ms(heard.legs[2], 75 * NS_PER_MS) == 115
    assert model.command_age_ms(heard.legs[0], 75 * NS_PER_MS) is None
    row = screen(model, 75 * NS_PER_MS).splitlines()[6]
    assert row.startswith(" 3  ●  90.00° ")
    assert row.endswith("━━━━╸─────   115 ms")
    assert screen(model, 5 * NS_PER_S).splitlines()[6].endswith("?"), "a silent gateway's age is not known"


@pytest.mark.parametrize(
    ("watchdog", "age_ms", "shown"),
    [
        (WatchdogState.EXPIRED, 3_240, "EXPIRED, 3.2 s ago"),
        (WatchdogState.IDLE, 3_240, "3.2 s ago"),
        (WatchdogState.IDLE, 600_000, "10 min ago"),
        (WatchdogState.IDLE, 36_000_000, "10 h ago"),
        (WatchdogState.IDLE, None, "never"),
    ],
)
def test_a_leg_that_does_not_run(watchdog: WatchdogState, age_ms: float | None, shown: str) -> None:
    model = Model()
    model.received_state(state(watchdog=watchdog, age_ms=age_ms), 0, WALL)
    assert screen(model).splitlines()[6].endswith(f" {shown}")


# ---- rates


def test_rates_come_from_the_gateways_own_clock() -> None:
    model = Model()
    assert model.rates() is None
    model.received_state(state(10.0, counts=(100, 10, 1), frames=200), 0, WALL)
    assert model.rates() is None
    # Two states that the network delayed and delivered together: the time between them is the gateway's.
    model.received_state(state(10.5, counts=(125, 15, 1), frames=225), 9 * NS_PER_S, WALL)
    assert model.rates() == Counts(50, 10, 0, 50)


def test_rates_are_of_the_last_two_seconds() -> None:
    model = Model()
    for tick in range(101):  # ten seconds at 10 Hz: silence, and then 50 commands a second for one
        accepted = max(0, tick - 90) * 5
        model.received_state(state(10 + tick / 10, counts=(accepted, 0, 0)), tick * 100 * NS_PER_MS, WALL)
    rates = model.rates()
    assert rates is not None
    assert rates.accepted == pytest.approx(25, rel=0.06)


def test_slow_states_give_rates_too() -> None:
    model = Model()
    for tick in range(4):
        model.received_state(state(10 + 5 * tick, counts=(50 * tick, 0, 0)), tick * 5 * NS_PER_S, WALL)
    assert model.rates() == Counts(10, 0, 0, 0)


# ---- rejections and events


def test_rejections_are_counted_by_source_with_those_left_out() -> None:
    """What the gateway's own limit says is what the model counts."""
    model, limit = Model(), RejectionLimit()
    for number in range(1000):  # 100 a second for ten seconds
        now_ns = number * 10 * NS_PER_MS
        left_out = limit.admit("anna", now_ns)
        if left_out is not None:
            model.received_event(rejected("anna", left_out=left_out), now_ns, WALL)
    waiting = limit.admit("anna", 20 * NS_PER_S)
    assert waiting is not None
    model.received_event(rejected("anna", reason=Reason.SERVO_STOPPED, left_out=waiting), 20 * NS_PER_S, WALL)
    model.received_event(rejected("bob"), 20 * NS_PER_S, WALL)
    assert model.rejected == {"anna": 1001, "bob": 1}
    assert model.reasons["anna"] is Reason.SERVO_STOPPED
    assert "anna 1001 (servo_stopped)  bob 1 (invalid)" in screen(model_with_state(model))


def test_whoever_invents_names_shares_one_line() -> None:
    model = Model()
    for number in range(COUNTED_SOURCES + 36):
        model.received_event(rejected(f"name {number}"), 0, WALL)
    model.received_event(rejected(None), 0, WALL)
    assert len(model.rejected) == COUNTED_SOURCES + 1
    assert model.rejected[OTHERS] == 37


def test_other_events_are_no_rejections() -> None:
    model = Model()
    model.received_event(event(Kind.ESTOP_ENGAGED, "emergency stop", "anna"), 0, WALL)
    assert model.rejected == {}
    assert model.lines[0].text == "emergency stop (anna)"
    assert model.lines[0].bad


def test_what_others_wrote_cannot_steer_the_terminal() -> None:
    model = model_with_state(Model())
    evil = "\x1b[2J\x1b]0;owned\x07\r\n\u202e"
    model.received_event(rejected(f"a{evil}", f"b{evil}"), 0, WALL)
    model.received_event(event(Kind.ESTOP_ENGAGED, f"c{evil}", f"d{evil}"), 0, WALL)
    model.answered(Tone.BAD, f"e{evil}", 0)
    shown = screen(model, height=40)
    assert all(char.isprintable() for char in shown.replace("\n", ""))
    assert "[2J" in shown  # it is shown, and does nothing


# ---- emergency stop and reset


def test_a_stop_that_is_confirmed_says_how_many_frames_and_how_soon() -> None:
    model = model_with_state(Model())
    model.stop.press(0)
    assert "EMERGENCY STOP sent" in screen(model)
    model.stop.confirm(STOPPED, None, 3 * NS_PER_MS)
    assert model.stop.wanted_ns is None
    shown = " ".join(screen(model).split())
    assert "STOPPED: 6 Stop frames written within 812 µs of the request, confirmed 3 ms after the key" in shown


def test_a_living_gateway_that_takes_no_stop_is_named_as_such() -> None:
    model = model_with_state(Model())
    model.stop.press(0)
    model.stop.unanswered()
    assert "the gateway runs but does not take it" in " ".join(screen(model, NS_PER_MS).split())
    model.received_state(state(10.1, Mode.ESTOPPED), 2 * NS_PER_MS, WALL)  # somebody else could
    assert model.stop.wanted_ns is None
    assert "ESTOPPED, as its state says" in screen(model, 2 * NS_PER_MS)


def test_an_answer_that_comes_after_the_state_says_more_than_it() -> None:
    model = model_with_state(Model())
    model.stop.press(0)
    model.stop.unanswered()
    model.received_state(state(10.1, Mode.ESTOPPED), NS_PER_MS, WALL)
    model.stop.confirm(STOPPED, None, 2 * NS_PER_MS)
    assert "STOPPED: 6 Stop frames" in screen(model, 3 * NS_PER_MS)


def test_what_became_of_a_later_key_replaces_what_became_of_the_stop() -> None:
    model = model_with_state(Model())
    model.stop.press(0)
    model.stop.confirm(STOPPED, None, 1)
    model.answered(Tone.GOOD, "released", 2)
    assert "STOPPED: 6" not in screen(model)
    assert "released" in screen(model)
    model.stop.press(3)
    model.stop_pressed()
    assert "released" not in screen(model)


def test_stopped_is_not_said_over_a_robot_that_may_move_again() -> None:
    model = model_with_state(Model())
    model.stop.press(0)
    model.stop.confirm(STOPPED, None, 1)
    model.received_state(state(10.1, Mode.ESTOPPED), 2, WALL)
    assert "STOPPED: 6" in screen(model)
    model.received_state(state(10.2, Mode.IDLE), 3, WALL)
    assert "STOPPED: 6" not in screen(model)


def test_nothing_to_reset() -> None:
    model = model_with_state(Model())
    model.ask(Confirmation.RESET, 0)
    assert model.asking(0) is None
    assert "no emergency stop is engaged" in screen(model)


# ---- who is driving, in `watch`: the top line, and the questions behind its keys


ANNA = LeaseReport(holder="anna", verified=True, held_s=12.3, expires_in_ms=800)


def driven(part: LeaseReport | ButtonsReport, mode: Mode = Mode.ACTIVE) -> Model:
    model = Model()
    name = "lease" if isinstance(part, LeaseReport) else "buttons"
    model.received_state(state(mode=mode, running=True).model_copy(update={name: part}), 0, WALL)
    return model


@pytest.mark.parametrize(
    ("part", "shown"),
    [
        (LeaseReport(), " ACTIVE   1 leg running  tcp/robot:7447"),
        (ANNA, " ACTIVE   1 leg running  anna drives  tcp/robot:7447"),
        (ANNA.model_copy(update={"asked_by": "bert"}), "  anna drives, bert asks  tcp/robot:7447"),
        (ANNA.model_copy(update={"verified": False}), "  anna? drives  "),
        (ANNA.model_copy(update={"held_s": None, "holder": "bert"}), "  handed to bert  "),
        (ANNA.model_copy(update={"holder": "x\x1b[2J" + "y" * 60}), "  x\\x1b[2Jyyyyy… drives  "),
        (ButtonsReport(required=1, alive=2, names=("kitchen", "door")), "1 leg running  buttons 2/1  tcp/robot:7447"),
        (ButtonsReport(required=2, alive=1, names=("kitchen",)), "1 leg running  buttons 1/2  tcp/robot:7447"),
    ],
)
def test_the_top_line_says_who_drives_and_how_many_watch(part: LeaseReport | ButtonsReport, shown: str) -> None:
    assert shown in screen(driven(part)).splitlines()[0]


QUESTIONS = {
    Confirmation.RESET: (
        "Leave the emergency stop? Nothing moves until it is started again. y: yes n: no",
        "no reset: the emergency stop stays engaged",
    ),
    Confirmation.TAKE: ("Take it from anna? All six legs stop first. y: yes n: no", "not taken"),
}
"""Their words, and what is said to a no."""


@pytest.mark.parametrize("question", Confirmation)
def test_a_question_does_not_stand_for_ever_a_stop_takes_it_back_and_a_no_is_confirmed(question: Confirmation) -> None:
    model = driven(ANNA, Mode.ESTOPPED)
    for other in Confirmation:  # a y answers one of them only
        model.ask(other, 0)
    model.ask(question, 0)
    asked, no = QUESTIONS[question]
    assert asked in " ".join(screen(model).split())
    assert model.asking(QUESTION_NS - 1) is question
    assert (model.asking(QUESTION_NS), model.question(QUESTION_NS)) == (None, None)
    model.look(QUESTION_NS, WALL)
    assert model.asking(0) is None
    model.ask(question, 0)
    model.stop_pressed()
    assert model.asking(1) is None
    model.ask(question, 2)
    model.declined(3)
    assert model.asking(3) is None
    assert model.remark is not None
    assert (model.remark.tone, model.remark.text) == (Tone.NOTE, no)


def test_where_nobody_drives_the_question_says_what_it_means_for_others() -> None:
    model = driven(LeaseReport())
    model.ask(Confirmation.TAKE, 0)
    assert "Drive? Nobody else's starts, sets and resets count then" in screen(model)


def test_what_became_of_a_take() -> None:
    model = driven(ANNA)
    model.ask(Confirmation.TAKE, 0)
    model.take_confirmed(2)
    assert model.asking(2) is None
    model.answered(Tone.BAD, "NOT DONE: lease_denied: no\x1b", 4)
    assert model.remark is not None
    assert (model.remark.tone, model.remark.text) == (Tone.BAD, "NOT DONE: lease_denied: no\\x1b")


def test_the_keys_stand_on_the_last_line() -> None:
    last = screen(driven(ANNA)).splitlines()[-1]
    assert last == " SPACE or e: EMERGENCY STOP   r: reset  q: quit  a: ask  t: take  (● on  ○ off)"
