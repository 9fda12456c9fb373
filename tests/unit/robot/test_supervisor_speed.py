"""A servo whose speed is limited goes to its target in steps, one in each rate slot. Each step is judged."""

from collections.abc import Callable

import pytest

from gateway.allowance import NS_PER_MS
from gateway.robot.core.events import Command
from gateway.robot.core.leg import Rules
from tests.support.steps import Steps, leg_to, servo_to


def speed_steps(deg_s: float = 100) -> Steps:
    """Servo 31 runs at 90 degrees since 0 ms; leg 3 has a rate slot each 20 ms."""
    steps = Steps(Rules(repeats=0, max_speed_cdeg_s={31: round(deg_s * 100)}))
    steps.command(1, leg_to(3, "start 90"))
    return steps


def angles(steps: Steps, until_ms: float) -> list[float]:
    """What servo 31 is told as time passes."""
    said: list[float] = []
    while steps.due_ms is not None and steps.due_ms <= until_ms:
        for line in steps.time(steps.due_ms):
            words = line.split()
            if words[:3] == ["command", "31", "set"]:
                said.append(float(words[3]))
            else:
                assert words[0] != "command", line
    return said


def test_a_far_target_is_approached_and_reached() -> None:
    steps = speed_steps()
    assert steps.command(51, servo_to(31, "set 110")) == ["command 31 set 92", "completed 2"]
    said = angles(steps, 300)
    assert said == sorted(said)
    assert said[-1] == 110
    assert len(said) >= (110 - 92) / (100 / 50)


def test_a_near_target_is_reached_at_once() -> None:
    steps = speed_steps()
    assert steps.command(51, servo_to(31, "set 91.9"))[0] == "command 31 set 91.9"
    assert angles(steps, 200) == []


def test_the_newest_target_counts() -> None:
    steps = speed_steps()
    steps.command(51, servo_to(31, "set 180"))
    assert steps.command(71, servo_to(31, "set 85"))[0] == "command 31 set 90"
    assert angles(steps, 300)[-1] == 85


def test_a_start_of_a_servo_that_runs_is_no_way_round_it() -> None:
    assert speed_steps().command(51, servo_to(31, "start 180"))[0] == "command 31 start 92"


def test_a_start_of_one_that_does_not_run_goes_where_it_says() -> None:
    steps = Steps(Rules(repeats=0, max_speed_cdeg_s={31: 100}))
    assert steps.command(1, servo_to(31, "start 180"))[0] == "command 31 start 180"


def test_other_servos_are_as_quick_as_ever() -> None:
    assert speed_steps().command(51, leg_to(3, "set 180"))[0] == "command 3 set 92 | set 180 | set 180"


@pytest.mark.parametrize(("others", "deg"), [((32, 33), 91), ((32,), 92)], ids=["a leg's frame", "another servo's"])
def test_a_frame_that_tells_it_its_angle_again_counts_as_its_last(others: tuple[int, ...], deg: int) -> None:
    steps = speed_steps()
    steps.command(41, tuple(target for servo_id in others for target in servo_to(servo_id, "set 80")))
    assert steps.command(51, servo_to(31, "set 180"))[0] == f"command 31 set {deg}"


def test_its_start_counts_as_its_last_frame_too() -> None:
    assert speed_steps().command(6, servo_to(31, "set 180"))[0] == "command 31 set 90.5"


def avoiding() -> Steps:
    """Servo 31 may go 50 degrees a second; 1 to 4 degrees are never sent."""
    return Steps(Rules(repeats=0, timeout_ns=10**10, max_speed_cdeg_s={31: 50_00}, avoid_cdeg=(1_00, 4_00)))


@pytest.mark.parametrize("ended_by", ["a stop", "a new holder"])
def test_a_way_across_that_has_ended_is_no_part_of_the_next(ended_by: str) -> None:
    steps = avoiding()
    steps.command(1, servo_to(31, "start 6"))
    steps.command(21, servo_to(31, "set 0"))
    assert angles(steps, 90)[-1] == 4, "its way would be at about 2.5 now"
    if ended_by == "a stop":
        steps.command(100, servo_to(31, "stop"))
        steps.command(120, servo_to(31, "start 4"))
    else:
        steps.lease(120, "acquire anna", fresh="a" * 32)
    steps.command(200, servo_to(31, "set 0"), lease="a" * 32 if ended_by == "a new holder" else None)
    assert set(angles(steps, 240)) == {4}, "the whole way takes 60 ms, and it began at 200"


def across(user_deg: float, at_ms: float = 21) -> list[float]:
    """What servo 31 is told on its way from 6 degrees."""
    steps = avoiding()
    steps.command(1, servo_to(31, "start 6"))
    (said, *_) = steps.command(at_ms, servo_to(31, f"set {user_deg:g}"))
    return [float(said.split()[-1]), *angles(steps, 1000)]


def test_a_way_across_angles_that_are_never_sent_waits_before_them_until_it_would_be_beyond() -> None:
    said = across(0)
    assert said[:2] == [5, 4.3] or said[:2] == [5, 4.75]
    assert {angle for angle in said if 0.99 < angle <= 4} == {4}, "the last angle before them"
    assert said[-1] == 0
    assert 4 <= len([angle for angle in said if angle == 4]) <= 4 * 4, "for as long as the way takes, in each rate slot"
    assert not [angle for angle in said if 1 <= angle < 4]


@pytest.mark.parametrize("word", ["stop", "estop", "silence"])
def test_a_stop_ends_it(word: str) -> None:
    steps = speed_steps(10)
    steps.command(51, servo_to(31, "set 180"))
    if word == "stop":
        steps.command(60, servo_to(31, "stop"))
    elif word == "estop":
        steps.estop(60)
    else:
        assert angles(steps, 400)
        assert not steps.running
    assert not angles(steps, 1000)
    assert 31 not in steps.running


def test_under_a_new_holder_of_the_lease_nothing_goes_on_to_where_somebody_else_sent_it() -> None:
    steps = Steps(Rules(repeats=0, max_speed_cdeg_s={11: 100_00}))
    steps.command(10, servo_to(11, "start 0"))
    assert steps.command(100, servo_to(11, "set 90")) == ["command 11 set 2", "completed 2"]
    assert steps.lease(101, "acquire anna", fresh="a" * 32) == ["announce lease_acquired", "granted"]
    assert steps.time(249) == []
    assert steps.time(350) == ["watchdog 1 stop", "announce watchdog_expired"]


# ---- a command that is rejected once it has begun


REJECTED_MS = 3000


def begun() -> Steps:
    """Command 7 sends servo 31 on its way, and its start of servo 11 waits for its turn, until 4010 ms.

    Leg 5 is silent from `REJECTED_MS` on.
    """
    timeout_ns, pause_ns = 1000 * NS_PER_MS, 2000 * NS_PER_MS
    steps = Steps(
        Rules(timeout_ns, repeats=0, rest_runs=0, power=True, start_pause_ns=pause_ns, max_speed_cdeg_s={31: 10_00})
    )
    steps.board(5)
    steps.command(10, leg_to(5, "start 90"))
    steps.board(10)
    for at_ms in (500, 1000, 1500, 2000):
        steps.command(at_ms, leg_to(5, "set 90"))
    steps.command(2005, servo_to(31, "start 0"))
    assert "command 31 start 0" in steps.board(2010)
    said = steps.command(2100, (*servo_to(31, "set 180"), *servo_to(11, "start 90")))
    assert said == ["command 31 set 0.2"]
    assert angles(steps, REJECTED_MS - 1)[-1] == 9
    return steps


def stop_another_leg(steps: Steps) -> list[str]:
    return steps.command(REJECTED_MS - 1, leg_to(2, "stop"))


def take_the_supply_of_one(steps: Steps) -> list[str]:
    return steps.board(REJECTED_MS - 1, lost=(11,))


def lose_messages_of_one(steps: Steps) -> list[str]:
    return steps.take(REJECTED_MS - 1, Command(servo_to(11, "stop"), key="lost", number=99, lost=True))


def be_silent(steps: Steps) -> list[str]:
    return steps.time(REJECTED_MS)


REJECTING = [stop_another_leg, take_the_supply_of_one, lose_messages_of_one, be_silent]


@pytest.mark.parametrize("reject", REJECTING)
def test_a_servo_does_not_go_on_to_where_a_rejected_command_has_sent_it(reject: Callable[[Steps], list[str]]) -> None:
    steps = begun()
    assert "rejected 7" in " ".join(reject(steps))
    assert 31 in steps.running
    assert angles(steps, REJECTED_MS + 90) == [], "it holds where it is"


@pytest.mark.parametrize("reject", REJECTING)
def test_it_goes_on_to_where_a_newer_command_has_sent_it(reject: Callable[[Steps], list[str]]) -> None:
    steps = begun()
    newer = steps.command(REJECTED_MS - 2, servo_to(31, "set 100"))
    assert "rejected" not in " ".join(newer)
    assert "rejected 7" in " ".join(reject(steps))
    assert angles(steps, REJECTED_MS + 90)[-1] > 9.2
