"""The walk command in virtual time: what the robot does now, in a sentence; how it ends; and its keys."""

import errno
import io
import math
import re
import signal
import sys
from collections import deque
from collections.abc import Callable, Collection
from typing import Any, Final, NoReturn, cast

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.errors import WalkError
from gateway.people.client.walk import Walk
from gateway.people.commands.walk.screen import REPEATED_S, SPEEDS, STOP_KEYS, Keypad
from gateway.people.commands.walk.script import AtOnce, EndRequests, go
from gateway.people.terminal import Keyboard, on_end_signals
from gateway.people.walking.gait_speed import MOST_M, MOST_RAD, SLEW_M_S2, Distance
from gateway.people.walking.motion import ORIGIN, STILL, BodyPose, Odometry, Posture, Velocity, WalkState
from gateway.people.walking.ride import Ride
from gateway.people.walking.transitions import LONGEST_S
from gateway.people.walking.words import NEWS_S, Newest, ground_now, robot_now
from schemas.gateway_state import ControllerReport, GatewayState
from schemas.robot import LEGS
from schemas.words import Mode
from tests.support.published import servo, state
from tests.support.ridden import Ridden, standing
from tests.support.walked import TICK_S

ALL = frozenset(LEGS)
LIMP = "All six legs are stopped, and hold no weight"


def of(running: Collection[int], mode: Mode = Mode.ACTIVE, **changed: object) -> GatewayState:
    """Return the gateway's state while exactly these legs run."""
    return state(mode=mode, running=running).model_copy(update=changed)


def walk(posture: Posture, *lost: int) -> WalkState:
    return WalkState(posture, "tripod", 0.15, STILL, STILL, "", ORIGIN, lost)


def partly(*partly: int) -> GatewayState:
    """Return legs that all run, but of these one servo only."""
    found = of(ALL)
    legs = [
        leg.model_copy(update={"servos": tuple(servo(each.id, each is leg.servos[0]) for each in leg.servos)})
        if leg.leg in partly
        else leg
        for leg in found.legs
    ]
    return found.model_copy(update={"legs": tuple(legs)})


ESTOPPED = of((), Mode.ESTOPPED, estop_source="anna")
BY_ANNA = "Emergency stop by anna: nothing runs until a reset"
SILENT = ControllerReport(alive=False)


@pytest.mark.parametrize(
    ("found", "driver", "sentence"),
    [
        (of(()), None, "No servo runs"),
        (of((1, 3, 4)), None, "Legs 1, 3 and 4 run"),
        (of(ALL), None, "All six legs run"),
        (of(()), walk(Posture.LYING), "It lies"),
        (of(ALL), walk(Posture.SITTING), "It sits"),
        (of(ALL), walk(Posture.STANDING), "It stands"),
        (of(ALL), walk(Posture.WALKING), "It walks"),
        (of(ALL), walk(Posture.MOVING), "It moves to another posture"),
        (of(ALL - {3}), walk(Posture.HALTED, 3), "Leg 3 is stopped, and the others stand still"),
        # its driver does not know yet, or holds them no more
        (of(ALL - {3, 4}), walk(Posture.HALTED, 3), "Legs 3 and 4 are stopped, and the others run"),
        (of(ALL - {3}), walk(Posture.WALKING), "Leg 3 is stopped, and the others run"),
        (of(ALL), walk(Posture.HALTED), "All six legs run"),
        # limp, whatever was lost first, and whatever was wanted
        (of(()), walk(Posture.HALTED, 3), LIMP),
        (of(()), walk(Posture.WALKING), LIMP),
        # one servo of a leg is no leg that stands
        (partly(*LEGS), walk(Posture.STANDING), "All six legs run"),
        (partly(1), walk(Posture.HALTED, 1), "Leg 1 is stopped, and the others stand still"),
        # an emergency stop holds until the reset and no longer
        *((ESTOPPED, driver, BY_ANNA) for driver in (None, walk(Posture.HALTED, 3), walk(Posture.WALKING))),
        (of((), Mode.ESTOPPED), walk(Posture.WALKING), "Emergency stop: nothing runs until a reset"),
        (of((), Mode.IDLE, estop_source="anna"), None, "No servo runs"),
        # a controller that fell silent, and what the gateway knows without a bus fault
        (of(ALL, Mode.BUS_FAULT, controller=SILENT), None, "The controller is silent: what was written may not have "
         "arrived"),
        (of(ALL, controller=SILENT), None, "All six legs run"),
    ],
)  # fmt: skip
def test_what_runs_decides_and_the_posture_only_names_it(
    found: GatewayState, driver: WalkState | None, sentence: str
) -> None:
    assert robot_now(found, NEWS_S, driver) == sentence


def test_an_older_state_that_comes_later_changes_nothing_and_a_gateway_that_began_anew_does() -> None:
    newest, driver = Newest(), walk(Posture.STANDING)
    assert "no state yet" in newest.sentence(0.0, driver)
    newest.take(of(ALL, uptime_s=10.0), 100.0)
    newest.take(of((), uptime_s=9.9), 100.1)
    assert newest.sentence(100.9, driver) == "It stands"
    assert "is 2 s old" in newest.sentence(102.0, driver)
    newest.take(of((), uptime_s=10.0 - NEWS_S), 102.0)
    assert newest.sentence(102.0, driver) == LIMP


@pytest.mark.parametrize(
    ("felt", "sentence"),
    [
        ({"terrain": "level", "tilt_deg": 3.0}, ""),
        ({}, "No sensors: it walks as on a level floor"),
        ({"tilt_deg": 3.14, "corrected_deg": 6.0}, "Leans by 3.1°, 6.0° corrected"),
        (
            {"tilt_deg": 3.14, "carrying": (True, False, False, True, True, False), "hanging": (2,)},
            "Leans by 3.1°, 0.0° corrected; legs 1, 4 and 5 carry; leg 2 hangs over an edge",
        ),
        ({"carrying": (False,) * 6, "hanging": (2, 6)}, "No leg carries; legs 2 and 6 hang over an edge"),
        ({"carrying": (True, *(False,) * 5)}, "Leg 1 carries"),
    ],
)
def test_what_a_walk_by_sensors_feels_is_one_sentence(felt: dict[str, Any], sentence: str) -> None:
    assert ground_now(walk(Posture.WALKING)._replace(**{"terrain": "adapt", **felt})) == sentence


AHEAD: Final = Velocity(0.1)


class Walked:
    """As `Walk` is to a program: each call waits for what it asks for."""

    def __init__(self, ticked: Callable[["Walked"], None] = lambda _: None) -> None:
        self.ridden = Ridden()
        self.walked_s = 0.0
        self._ticked = ticked

    @property
    def state(self) -> WalkState:
        return self.ridden.ride.state

    def go(self, forward_m_s: float = 0.0, left_m_s: float = 0.0, turn_rad_s: float = 0.0) -> None:
        begun_s = self.ridden.now_s
        self.ridden.ride.go(Velocity(forward_m_s, left_m_s, turn_rad_s), begun_s)
        self.ridden.tick()
        if forward_m_s:
            self.walked_s += self.ridden.now_s - begun_s
        self._ticked(self)

    def stand(self, height_m: float | None = None, *, wait: bool = True) -> None:
        self.ridden.ride.stand(None if height_m is None else BodyPose(height_m), self.ridden.now_s)
        if wait:
            self.ridden.until(lambda: self.ridden.posture is Posture.STANDING)

    def sit(self) -> None:
        self.ridden.ride.sit(self.ridden.now_s)
        self.ridden.until(lambda: self.ridden.posture is Posture.SITTING)

    def clock(self) -> float:
        return self.ridden.now_s


def test_a_script_stands_up_walks_for_its_time_and_sits(capsys: pytest.CaptureFixture[str]) -> None:
    robot = Walked()
    assert go(cast(Walk, robot), AHEAD, 1.0, 0.14, EndRequests(), robot.clock)
    assert robot.walked_s == pytest.approx(1.0, abs=0.05)
    assert robot.state.posture is Posture.SITTING
    assert 0.02 < robot.state.odometry.x_m < 0.15
    said = capsys.readouterr().out
    assert said.startswith("walked 0.")
    assert said.endswith("m to the left, turned by 0°; it sits, and its servos are stopped\n")


class Closed(io.StringIO):
    """A terminal that is closed, which asks for the end: what is remarked then cannot be written."""

    def write(self, _: str) -> NoReturn:
        raise OSError(errno.EIO, "Input/output error")


@pytest.mark.parametrize(
    ("when", "terminal"),
    [(Posture.MOVING, io.StringIO()), (Posture.WALKING, io.StringIO()), (Posture.WALKING, Closed())],
    ids=["while it stands up", "while it walks", "by a terminal that is closed"],
)
def test_ended_early_it_finishes_its_step_and_sits(
    when: Posture, terminal: io.StringIO, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    end = EndRequests()

    def asks(robot: Walked) -> None:
        if robot.state.posture is when and robot.ridden.now_s > 101 and not end.asked:
            end.ask()

    robot = Walked(asks)
    monkeypatch.setattr(sys, "stderr", terminal)
    assert not go(cast(Walk, robot), AHEAD, 600.0, None, end, robot.clock)
    assert robot.walked_s < 0.2
    assert robot.state.posture is Posture.SITTING
    assert capsys.readouterr().out.startswith("ended early: walked ")


def test_asked_twice_it_is_cut_but_not_while_its_stops_are_sent() -> None:
    end = EndRequests()
    end.ask()
    with pytest.raises(AtOnce):
        end.ask()
    end.ask()
    other = EndRequests()
    other.stops()
    other.ask()
    other.ask()


# ---- so many metres ahead, so many radians round


def cover(ridden: Ridden, amount: float, *, turns: bool, late: int) -> tuple[float, float]:
    """Return the covered way when it stands again, and its highest speed. Velocities take effect so many ticks late."""
    distance, begin, fastest = Distance(amount, turns=turns), ridden.ride.state.odometry, 0.0
    waiting: deque[Velocity] = deque([STILL] * late)
    while (velocity := distance.next(ridden.ride.state, ridden.now_s)) is not None:
        waiting.append(velocity)
        ridden.ride.go(waiting.popleft(), ridden.now_s)
        ridden.tick()
        fastest = max(fastest, math.hypot(*ridden.ride.state.scaled))
    ridden.ride.stand(None, ridden.now_s)
    ridden.until(lambda: ridden.posture is Posture.STANDING)
    end = ridden.ride.state.odometry
    gone_m = math.hypot(end.x_m - begin.x_m, end.y_m - begin.y_m)
    return (end.heading_rad - begin.heading_rad if turns else math.copysign(gone_m, amount)), fastest


@pytest.mark.lengthy
@pytest.mark.parametrize("late", [0, 2])
@pytest.mark.parametrize(
    ("gait", "amount", "turns"),
    [("tripod", 0.3, False), ("ripple", -0.05, False), ("wave", 0.1, False), ("tripod", math.pi / 2, True)],
)
def test_a_course_ends_within_half_a_millimetre_or_a_seventh_of_a_degree(
    gait: str, amount: float, turns: bool, late: int
) -> None:
    ridden = Ridden()  # it lies, and stands up first
    ridden.ride.walk_as(gait, ridden.now_s)
    covered, fastest = cover(ridden, amount, turns=turns, late=late)
    assert covered == pytest.approx(amount, abs=0.0025 if turns else 0.0005)
    assert fastest <= (0.25 if turns else 0.08)


def test_less_than_half_a_millimetre_is_nothing_and_then_it_stands() -> None:
    assert cover(Ridden(), 0.0004, turns=False, late=0) == (0.0, 0.0)
    assert Distance(0.0005, turns=False).next(at(0.0), 0.0) is not None


@pytest.mark.parametrize(
    ("amount", "turns", "why"),
    [
        (200, False, "metres is 200, and at most 20 are taken; are these millimetres"),
        (-90, True, r"radians is -90, and at most 12.57 are taken; are these degrees"),
        (math.nan, False, "metres is nan; a distance is a finite number"),
        (True, False, "metres is True"),
    ],
)
def test_what_is_no_distance_is_rejected(amount: float, turns: bool, why: str) -> None:
    with pytest.raises(WalkError, match=why):
        Distance(amount, turns=turns)
    for most in (MOST_RAD, -MOST_RAD) if turns else (MOST_M, -MOST_M):
        Distance(most, turns=turns)


def test_a_script_does_not_wait_forever_for_a_robot_that_comes_no_nearer() -> None:
    ride: Ride = standing().ride
    distance = Distance(1.0, turns=False)
    now_s = 0.0
    while now_s <= LONGEST_S:
        assert distance.next(ride.state, now_s) is not None
        now_s += TICK_S
    with pytest.raises(WalkError, match="it has come no nearer for 30 s: it is standing"):
        distance.next(ride.state, now_s)


def at(x_m: float, y_m: float = 0.0, heading_rad: float = 0.0) -> WalkState:
    return walk(Posture.WALKING)._replace(odometry=Odometry(x_m, y_m, heading_rad))


def test_ahead_is_where_it_looks_and_it_slows_down_gently_before_the_end() -> None:
    distance = Distance(0.1, turns=False)
    assert distance.next(at(1.0, 2.0, 1.0), 0.0) == Velocity(forward_m_s=0.08)
    velocity = distance.next(at(1.0 + 0.098 * math.cos(1.0), 2.0 + 0.098 * math.sin(1.0), 1.0), 1.0)
    assert velocity is not None
    assert velocity.forward_m_s == pytest.approx(math.sqrt(SLEW_M_S2 * 0.002)), "half of what the engine can"
    assert distance.next(at(1.0 + 0.1 * math.cos(1.0), 2.0 + 0.1 * math.sin(1.0), 1.0), 2.0) is None


SPACES = (" ", "\0", "\u00a0", "\u202f", "\u3000")
"""Alone, with Ctrl, with AltGr, with Shift, and of full width."""
PIECES = st.binary(max_size=4) | st.sampled_from(
    [b"\x1b", b"[", b"\x1b[", b"\x1b[1;", b"\x1bO", *map(str.encode, SPACES)]
)


@given(st.lists(st.lists(PIECES).map(b"".join)))
@example([each.encode() for each in SPACES])
def test_the_space_bar_is_always_a_key_that_stops_whatever_else_is_held(parts: list[bytes]) -> None:
    keyboard = Keyboard()
    for part in parts:
        spaces = re.findall("|".join(SPACES).encode(), part)
        assert keyboard.keys(part).count(" ") == len(spaces)
    assert " " in STOP_KEYS


@pytest.mark.parametrize(
    ("parts", "keys"),
    [
        ([b"\x1b", b""], ["escape"]),
        ([b"\x1b\x1b"], ["escape"]),
        ([b"\x1b", b"w"], ["escape", "w"]),
        ([b"\x1b[A\x1bOB"], ["up", "down"]),
        ([b"\x1b[", b"A"], ["up"]),
        ([b"\x1b[1;", b"5A"], []),
        ([b"\x1b", b"", b"[A"], ["escape", "[", "A"]),
        ([b"\x1b[15~w"], ["w"]),
        (["цфыв".encode(), "ЦйУ".encode()], [*"wasdwqe"]),
        (["ςασδ".encode()], [*"wasd"]),
        ([b"\xd1", b"\x86"], ["w"]),
        (["é".encode()], ["é"]),
    ],
)
def test_escape_is_a_key_unless_an_arrow_follows(parts: list[bytes], keys: list[str]) -> None:
    keyboard = Keyboard()
    assert [key for part in parts for key in keyboard.keys(part)] == keys


def test_a_terminal_that_goes_does_not_end_what_nohup_keeps_running() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with on_end_signals(lambda: None):
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
            assert signal.getsignal(signal.SIGTERM) != signal.SIG_DFL
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        with on_end_signals(lambda: None):
            assert signal.getsignal(signal.SIGHUP) != signal.SIG_DFL
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)


# ---- held keys: no terminal reports that one is released


@pytest.mark.parametrize(("pause_s", "every_s"), [(0.25, 0.03), (0.5, 0.033), (0.66, 0.04), (0.5, 0.09)])
def test_a_held_key_has_no_gap_and_ends_soon_after_its_release(pause_s: float, every_s: float) -> None:
    """X11's, GNOME's and Windows' repetitions."""
    pad = Keypad()
    pad.press("up", 0.0)
    now_s = 0.0
    while now_s < 3.0:
        assert pad.velocity(now_s).forward_m_s > 0
        if now_s >= pause_s:
            pad.press("up", now_s)
            last_s = now_s
            now_s += every_s
        else:
            now_s = min(pause_s, now_s + 0.02)
    assert pad.velocity(last_s + REPEATED_S - 0.01) != STILL
    assert pad.velocity(last_s + REPEATED_S) == STILL


def test_another_key_ends_a_motion_and_the_newest_counts() -> None:
    pad = Keypad()
    pad.press("w", 0.0)
    pad.press("left", 0.1)
    assert pad.velocity(0.1).turn_rad_s > 0
    assert pad.velocity(0.1).forward_m_s == 0
    assert not pad.press("t", 0.2)
    assert pad.velocity(0.2) == STILL


def test_the_speed_has_ends() -> None:
    pad = Keypad()
    for _ in range(20):
        assert pad.press("+", 0.0)
    assert pad.speed_m_s == SPEEDS[-1]
    for _ in range(20):
        pad.press("-", 0.0)
    assert pad.speed_m_s == SPEEDS[0]
    pad.press("A", 0.0)
    assert pad.velocity(0.0).left_m_s == SPEEDS[0]
