"""elkapod-2025 with a power board that feeds each servo: which may be fed, and when the UART speaks."""

import pytest

from gateway.model import elkapod
from gateway.model.elkapod import SHUTDOWN, START
from gateway.model.frames import STARTS, STOP, Frame, OneLeg, OneServo
from gateway.robot.protocol.elkapod import Commanded
from tests.unit.robot.test_elkapod_wire import Parts


def start(servo_id: int, angle_cdeg: int = 80_00) -> Frame:
    return OneServo(servo_id, STARTS[angle_cdeg])


@pytest.fixture
def commanded() -> Commanded:
    return Commanded(fed_singly=True)


def cycle(commanded: Commanded) -> bytes | None:
    """A frame leaves; what the UART says behind it."""
    commanded.frame()
    return commanded.left()


def test_a_stop_of_one_is_the_boards_alone_while_others_run_or_wait(commanded: Commanded) -> None:
    commanded.take([start(11), start(12)])
    assert commanded.stop([12]) is None, "11 waits"
    assert [cycle(commanded) for _ in range(3)] == [None, START, None]
    assert commanded.ready == {11}, "12 does not come after its Stop"
    commanded.take([start(12)])
    assert commanded.stop([12]) is None, "11 runs"
    assert commanded.stop([11]) == SHUTDOWN, "the last one"
    assert commanded.ready == frozenset()


def test_a_stop_in_the_middle_of_a_transfer_stops_what_the_frame_would_start(commanded: Commanded) -> None:
    commanded.take([start(11), start(12)])
    cycle(commanded)
    commanded.frame()
    commanded.stop([11])
    assert commanded.left() == START
    assert commanded.ready == {12}


def test_a_start_with_another_angle_in_the_middle_of_a_transfer_counts_its_own_frames(commanded: Commanded) -> None:
    commanded.take([start(11, 80_00)])
    commanded.frame()
    commanded.take([start(11, 70_00)])
    said = [commanded.left(), cycle(commanded)]
    assert (said, commanded.ready) == ([None, None], frozenset()), "70 degrees were in one frame"
    assert (cycle(commanded), commanded.ready) == (START, frozenset({11}))


def test_a_frame_counts_once(commanded: Commanded) -> None:
    commanded.take([start(11)])
    commanded.frame()
    assert [commanded.left(), commanded.left()] == [None, None]
    assert cycle(commanded) == START


def test_a_servo_that_is_to_be_fed_is_prepared_and_one_that_is_not_any_more_begins_anew(commanded: Commanded) -> None:
    assert commanded.prepare({11: 80_00, 12: None}) == frozenset()
    assert [cycle(commanded), cycle(commanded)] == [None, START]
    assert commanded.prepare({11: 80_00, 12: None}) == {11}
    commanded.take([start(11, 70_00)])
    assert cycle(commanded) is None, "its start has been said"
    assert commanded.prepare({12: None}) == frozenset()
    assert commanded.prepare({11: 60_00}) == frozenset()
    assert [cycle(commanded), cycle(commanded)] == [None, START], "two frames with its new angle"
    assert commanded.prepare({11: 60_00}) == {11}


def test_a_servo_that_does_not_run_keeps_its_angle_in_a_frame_about_others(commanded: Commanded) -> None:
    commanded.take([start(13, 70_00)])
    commanded.take([OneLeg(1, (STARTS[80_00], STARTS[80_00], STOP))])
    assert elkapod.angles_of(commanded.frame())[13] == 70.0


def test_the_board_stops_one_leg_and_the_others_go_on() -> None:
    Parts(fed_singly=True).play("""
        open; at 100; starts; cycle 2; stops 1 → shutdown start; received [True]; ready 15""")
