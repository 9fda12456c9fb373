"""What `calibrate` does with each key, and what stands on the screen then."""

import threading
from collections.abc import Callable, Iterator
from functools import partial

import pytest
from rich.console import Console

from gateway.errors import LeaseError, LeaseLostError, UnansweredError
from gateway.people.tools.calibrate.guide import Guide
from gateway.people.tools.calibrate.held_servo import HeldServo
from gateway.people.tools.calibrate.session import Session
from gateway.people.tools.calibrate.view import picture
from gateway.robot.core.calibration import Calibration, ServoCalibration
from schemas.telemetry import Reason
from tests.support.calibrated_robot import LATE_S, KeptCalibration, Servos


class Person:
    """Somebody at the keys, who reads the screen."""

    def __init__(self, calibration: Calibration) -> None:
        self.servos = Servos()
        self.robot = KeptCalibration(calibration)
        self.guide = Guide(calibration)
        self.held = HeldServo(self.servos, timeout_ms=20)
        self.changed = threading.Event()
        self.session = Session(self.guide, self.held, self.robot, self.changed.set)

    @property
    def screen(self) -> str:
        with self.session.lock:
            self.session.turn()
            return " ".join(picture(self.session, "here", 24, 80).plain.split())

    def press(self, *keys: str) -> bool:
        return [self.session.press(key) for key in keys][-1]

    def sees(self, *texts: str) -> None:
        self.waits(lambda: all(text in self.screen for text in texts), f"{texts}")

    def waits(self, holds: Callable[[], bool], what: str) -> None:
        pause = threading.Event()
        for _ in range(int(LATE_S / 0.01)):
            if holds():
                return
            pause.wait(0.01)
        pytest.fail(f"no {what} in: {self.screen}")

    def tests(self, servo_id: int, begin_deg: float = 90.0) -> None:
        """Start this servo where the screen proposes it."""
        self.press(*str(servo_id), "enter")
        self.sees(f"Servo {servo_id} goes there AT ONCE", f"Start it at: {begin_deg:g}_")
        self.press("enter")
        self.sees(f"servo {servo_id} RUNS at {begin_deg:g}°")

    def steps(self, *keys: str) -> None:
        """Each once the one before is confirmed, as a person's keys are slower than the gateway."""
        for key in keys:
            before = self.guide.wire_cdeg
            self.waits(partial(self._steps, key, before), key)

    def _steps(self, key: str, before_cdeg: int) -> bool:
        return self.press(key) and self.guide.wire_cdeg != before_cdeg


@pytest.fixture
def person() -> Iterator[Person]:
    here = Person(Calibration())
    yield here
    for event in here.servos.answers.values():
        event.set()
    here.servos.fails.clear()  # closing waits for a Stop that is confirmed
    here.held.close(LATE_S)


def test_a_horn_that_is_seven_degrees_off(person: Person) -> None:
    person.tests(32)
    person.steps(*["right"] * 7)
    person.sees("servo 32 RUNS at 97°")
    person.press("=", "9", "0", "enter")
    person.sees("trim +7°", "RUNS at 90° 97° by revision 0, which is in force", "*+7°")
    person.press("escape")
    person.sees("servo 32 is stopped", "Servo: _", "* not written yet")
    assert person.servos.running == set()
    person.press("w")
    person.sees("Write the calibration of servo 32?")
    person.press("y")
    person.sees("written: revision 1", "revision 1 you drive", " +7°")
    assert "not written yet" not in person.screen
    assert person.robot.in_force.of(32) == ServoCalibration(7_00)
    assert person.press("q") is False


def test_direction_limits_and_taking_back(person: Person) -> None:
    person.tests(32)
    person.press("i")
    person.sees("turned round", "0° inv")
    person.steps("right")
    person.sees("RUNS at 91°")
    person.servos.wait(lambda asked: (32, "set", 89.0) in asked)
    person.press("]")
    person.steps("left", "left", "down")
    person.press("[")
    person.sees("lowest angle: 88.9°", "0° inv 88.9…91")
    person.press("u")
    person.sees("servo 32: taken back", "0° inv 0…91")
    person.press("f")
    person.sees("0° inv ")
    person.press("d")
    person.sees("as drawn: no trim")
    assert person.guide.changed == []
    assert person.robot.in_force.revision == 0


def test_the_screen_shows_where_the_gateway_let_it_go(person: Person) -> None:
    person.servos.highest_deg = 90.5
    person.tests(32)
    person.steps("up", "up", "up", "up", "up", "up")
    person.sees("90.6 is outside", "RUNS at 90.5°")


def test_a_start_that_is_rejected_is_asked_for_again(person: Person) -> None:
    person.servos.highest_deg = 80
    person.press("3", "2", "enter", "enter")
    person.sees("servo 32 is not started: joint_limit: 90 is outside", "Start it at: 90_")
    person.press("backspace", "backspace", "7", "0", "enter")
    person.sees("RUNS at 70°")


def test_a_typed_angle_replaces_the_suggested_one(person: Person) -> None:
    person.press("3", "2", "enter")
    person.sees("Start it at: 90_")
    person.press("4", "5", "enter")
    person.sees("servo 32 RUNS at 45°")


def test_the_second_test_begins_where_the_first_one_ended(person: Person) -> None:
    person.tests(32)
    person.steps("left", "left")
    person.press(" ")
    person.sees("all six legs are stopped")
    person.tests(31)
    person.press("q")
    person.sees("servo 31 is stopped")
    person.tests(32, 88.0)


def test_pasted_text_starts_nothing_and_writes_nothing(person: Person) -> None:
    for key in ("3", "2", "enter", "enter"):
        person.session.press(key, alone=False)
    person.sees("that came with other keys, as if pasted", "Start it at: 90_")
    assert person.servos.asked == []
    person.press("escape")
    person.guide.choose(32)
    person.guide.wrong_way()
    person.guide.leave()
    for key in ("w", "y"):
        person.session.press(key, alone=False)
    person.sees("as if pasted", "Write the calibration of servo 32?")
    person.press("n")
    person.sees("not written")
    assert person.robot.in_force.revision == 0


@pytest.mark.parametrize("key", ["escape", " "])
def test_a_stop_ends_a_start_that_waits_for_the_gateway(person: Person, key: str) -> None:
    person.servos.answers["start"].clear()
    person.press("3", "2", "enter", "enter")
    person.servos.wait(lambda asked: (32, "start", 90.0) in asked)
    person.press(key)
    person.servos.wait(lambda asked: asked[-1][1] == "stop")
    person.servos.answers["start"].set()
    person.waits(lambda: not person.held.stopping, "end of it")
    person.sees("Servo: _")
    assert person.servos.running == set()


@pytest.mark.parametrize("key", ["escape", " "])
def test_a_stop_before_anything_is_started_ends_it(person: Person, key: str) -> None:
    person.robot.answers.clear()
    person.press("3", "2", "enter", "enter")
    person.sees("starting servo 32 …")
    person.press("enter")
    person.sees("starting servo 32 … Space or Esc gives it up")
    person.press(key)
    person.robot.answers.set()
    assert person.changed.wait(LATE_S)
    person.sees("Servo: _")
    assert all(asked[1] == "stop" for asked in person.servos.asked)


def test_without_the_lease_nothing_starts(person: Person) -> None:
    person.robot.trouble = LeaseError(Reason.LEASE_HELD, "anna holds the lease", "anna")
    person.press("3", "2", "enter", "enter")
    person.sees("rejected: lease_held: anna holds the lease", "Start it at: 90_")
    assert person.servos.asked == []


@pytest.mark.parametrize(("holder", "stops"), [(None, True), ("anna", False)])
def test_a_lost_lease_ends_the_test_and_keeps_the_draft(person: Person, holder: str | None, stops: bool) -> None:
    person.tests(32)
    person.press("i")
    person.session.lost(LeaseLostError(Reason.NOT_HOLDER, "the lease is lost, eve\x1b[2J holds it now", holder))
    person.sees("THE LEASE IS LOST, and the servo is stopped: the lease is lost, eve\\x1b[2J holds it now", "Servo: _")
    assert not person.held.holding.running
    assert any(asked[1] == "stop" for asked in person.servos.asked) is stops
    assert person.guide.changed == [32]


def test_a_stop_that_nobody_confirms_is_reported_until_one_is(person: Person) -> None:
    person.tests(32)
    person.servos.fails["stop"] = UnansweredError("no gateway answered")
    person.press("escape")
    person.sees("NOBODY HAS CONFIRMED THE STOP (no gateway answered): switch the servos' power off")
    person.servos.fails.clear()
    person.press(" ")
    person.sees("all six legs are stopped")
    assert "NOBODY" not in person.screen


def test_a_servo_that_somebody_else_stopped(person: Person) -> None:
    person.tests(32)
    person.servos.running.clear()
    person.sees("servo 32 does not run any more: servo_stopped", "Servo: _")


def test_a_gateway_that_does_not_answer_is_reported(person: Person) -> None:
    person.tests(32)
    person.servos.answers["set"].clear()
    person.sees("NO ANSWER for ", " s: the gateway's watchdog stops the servo")


# ---- two people


def test_what_somebody_else_wrote_meanwhile_stays_and_the_draft_stands_on_it(person: Person) -> None:
    person.tests(32)
    person.press("i", "escape")
    person.sees("servo 32 is stopped")
    person.robot.in_force = Calibration(3, {31: ServoCalibration(1_00), 32: ServoCalibration(5_00)}, {})
    person.press("w", "y")
    person.sees("NOT DONE: somebody else has changed the calibration meanwhile: revision 3 is in force")
    person.sees("Your changes of servo 32 stand on it now; w writes them", "changed servo 32: the table has yours")
    person.sees(" +1° ", "*0° inv")
    person.press("w", "y")
    person.sees("written: revision 4")
    assert person.robot.in_force.servos == {31: ServoCalibration(1_00), 32: ServoCalibration(inverted=True)}


def test_where_both_wanted_the_same_nothing_is_left_to_write(person: Person) -> None:
    person.tests(32)
    person.press("i", "escape")
    person.sees("servo 32 is stopped")
    person.robot.in_force = Calibration(1, {32: ServoCalibration(inverted=True)}, {})
    person.press("w", "y")
    person.sees("revision 1 is in force. It says what you wanted")
    assert person.guide.changed == []


def test_somebody_elses_change_is_seen_before_a_servo_starts_on_old_numbers(person: Person) -> None:
    person.robot.in_force = Calibration(1, {32: ServoCalibration(20_00)}, {})
    person.press("3", "2", "enter", "enter")
    person.sees("NOT DONE", "revision 1 is in force. The table shows it", "Servo: _")
    assert person.servos.asked == []
    person.tests(32)
    person.servos.wait(lambda asked: (32, "start", 90.0) in asked)


def test_a_landing_pose_that_is_not_reached_any_more_is_named_and_left_out(person: Person) -> None:
    person.guide.now_in_force(Calibration(1, {}, {32: 170_00, 31: 90_00}))
    person.robot.in_force = person.guide.in_force
    person.tests(32)
    person.press("=", "6", "0", "enter", "escape")
    person.sees("servo 32 is stopped")
    person.press("w")
    person.sees("The landing pose loses servo 32")
    person.press("y")
    person.sees("written: revision 2")
    assert person.robot.in_force.landing_cdeg == {31: 90_00}


# ---- small things


def test_what_is_no_servo_and_no_angle(person: Person) -> None:
    for typed in ("34", "", "3.2", "7"):
        person.press(*typed, "enter")
        person.sees("type a servo: the leg (1 to 6), then the joint (1 to 3), such as 32")
    person.press("3", "2", "enter")
    for typed, says in (("x", ""), ("...", "type an angle in degrees"), ("999", "is no angle of a servo")):
        person.press(*["backspace"] * 8, *typed)
        person.press("enter") if says else None
        person.sees(says)
    assert person.servos.asked == []
    person.press("escape")
    person.tests(32)
    person.press("=", "-", "9", "0", "enter")
    person.sees("trim_deg is 180; it is -90 to 90", "RUNS at 90°")


def test_leaving_with_a_draft_asks(person: Person) -> None:
    person.press("w")
    person.sees("nothing has changed, so there is nothing to write")
    person.press("u")
    person.sees("there is nothing to take back")
    person.tests(32)
    person.press("i", "escape")
    assert person.press("q")
    person.sees("Leave without writing what has changed?")
    assert person.press("q")
    person.sees("Servo: _")
    assert person.press("q")
    assert person.press("y") is False
    assert person.press("ctrl-c") is False


def test_what_the_calibration_in_force_forbids_says_how_it_is_opened(person: Person) -> None:
    person.robot.in_force = Calibration(1, {32: ServoCalibration(min_cdeg=89_00)}, {})
    person.guide.now_in_force(person.robot.in_force)
    person.tests(32)
    person.steps("left")
    person.press("left")
    person.waits(
        lambda: person.press("left") and "To open its limits: f, then Space, then w" in person.screen, "advice"
    )


@pytest.mark.parametrize(("columns", "rows", "table"), [(80, 24, True), (60, 20, False), (40, 10, False)])
def test_in_a_small_terminal_a_stop_that_nobody_confirms_is_not_pushed_off_the_screen(
    person: Person, columns: int, rows: int, table: bool
) -> None:
    person.tests(32)
    person.servos.fails["stop"] = UnansweredError("no gateway answered")
    person.press("i", "escape")
    person.sees("NOBODY HAS CONFIRMED THE STOP")
    with person.session.lock:
        text = picture(person.session, "here", rows, columns)
    shown = " ".join(" ".join(line.plain for line in text.wrap(Console(width=columns), columns)[:rows]).split())
    assert "NOBODY HAS CONFIRMED THE STOP" in shown
    assert "switch the servos' power off" in shown
    assert ("joint 1" in shown) is table
    assert ("The table of all servos needs" in text.plain) is not table
