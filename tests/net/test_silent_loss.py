"""A link that is lost without a sign: no reset, no close, no carrier that falls. Packets just do not arrive any more.

Toward the robot its watchdog is what notices. Toward the laptop only, setpoints still arrive until TCP has waited for
long enough for what confirms them; the driver's own program then knows that its lease is lost.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from schemas.robot import LEGS
from schemas.telemetry import Kind, Mode, Reason
from tests.net.hosts import LaptopHost, RobotHost, is_command
from tests.net.namespaces import Network
from tests.net.test_network import check_a_start_moves_it, check_lateness

pytestmark = pytest.mark.net

DIRECTIONS: dict[str, tuple[bool, bool]] = {
    "toward the robot": (True, False),
    "toward the laptop": (False, True),
    "both": (True, True),
}


@contextmanager
def lost(network: Network, *, toward_robot: bool, toward_laptop: bool) -> Iterator[None]:
    """Meanwhile packets between the first laptop and the robot are lost."""
    both: list[tuple[Callable[[], None], Callable[[], None]]] = []
    if toward_robot:
        address = network.robot_address(0)
        both.append((lambda: network.lose(0, address), lambda: network.find(0, address)))
    if toward_laptop:
        both.append((lambda: network.lose_answers(0), lambda: network.find_answers(0)))
    for lose, _ in both:
        lose()
    try:
        yield
    finally:
        for _, find in both:
            find()


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_silence_stops_the_legs_and_the_driver_learns_it(
    network: Network, robot: RobotHost, laptops: tuple[LaptopHost, LaptopHost], direction: str
) -> None:
    laptop, other = laptops
    toward_robot, toward_laptop = DIRECTIONS[direction]
    laptop.ask("lease acquire")
    laptop.start(*LEGS)
    laptop.stream(*LEGS)
    robot.wait_for_commands(*LEGS)
    with lost(network, toward_robot=toward_robot, toward_laptop=toward_laptop):
        check_lateness(direction, robot.wait_for_stops(*LEGS))
        robot.wait_for_event(lambda event: event.kind is Kind.LEASE_EXPIRED and event.source == laptop.source)
        assert not robot.running
        seen = laptop.ask("lost")
        print(f"{direction}: the driver's program says: {seen['detail']}")
        assert seen["rejected"] == Reason.NO_LEASE
        with pytest.raises(AssertionError, match="no gateway answered"):
            laptop.ask("state")
        assert other.ask("state")["mode"] == Mode.IDLE, "who is not cut off sees that it rests"
        robot.forget()
    laptop.wait_for_answer()  # behind whatever waited on the way
    assert laptop.ask("state")["mode"] == Mode.IDLE
    assert not robot.running
    assert not robot.seen(is_command(*LEGS)), "its stream goes on, and moves nothing"
    laptop.ask("pause")
    laptop.ask("lease acquire")
    check_a_start_moves_it(robot, laptop)
    laptop.ask("release")
