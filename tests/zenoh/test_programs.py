"""Programs that share a robot: who did it, and what stopped, by real clients of a real gateway."""

import warnings
from collections.abc import Iterator

import pytest

from gateway.client import Client, Stream
from gateway.errors import StoppedError
from schemas.telemetry import Cause, Kind
from tests.support.fixtures import gateway_fixture, patient
from tests.support.gateway_process import Gateway
from tests.support.heard import events

POSE = (90.0, 45.0, 120.0)
NAME = "my gait"
gateway = gateway_fixture(patient(4000))


@pytest.fixture
def two(gateway: Gateway) -> Iterator[tuple[Client, Client]]:
    """Two programs of one name."""
    with Client(gateway.endpoint, source=NAME) as first, Client(gateway.endpoint, source=NAME) as second:
        yield first, second


def hold(*streams: Stream) -> None:
    """Set leg 1 by these streams in turns, a second long."""
    for _ in range(50):
        for each in streams:
            each.set({1: POSE})


def test_two_programs_of_one_name_are_told_apart(two: tuple[Client, Client]) -> None:
    """Each is warned that another program of its name takes its leg, and states and events name both sessions."""
    first, second = two
    happened = events(first)
    with first.stream(50) as one, second.stream(50) as other:
        one.set({1: POSE})
        other.set({1: POSE})
        taken = happened.wait(lambda event: event.kind == Kind.SOURCE_CHANGED)
        assert (taken.source, taken.source_id) == (NAME, second.zid)
        assert taken.detail == "leg 1 is commanded by my gait, and was by another program named 'my gait'"
        leg = first.state().leg(1)
        assert (leg.source, leg.source_id) == (NAME, second.zid)
        with pytest.warns(UserWarning, match="another program named 'my gait'; both may move it") as warned:
            hold(one, other)
        assert len(warned) == 2


def test_a_stop_by_another_program_of_the_same_name_is_not_this_programs(two: tuple[Client, Client]) -> None:
    first, second = two
    happened = events(second)
    with warnings.catch_warnings(action="ignore"), first.stream(50) as one:
        one.set({1: POSE, 4: POSE})
        second.stop(1)
        with pytest.raises(StoppedError) as stopped:
            hold(one)
    assert str(stopped.value).startswith("another program named 'my gait' stopped leg 1")
    told = happened.wait(lambda event: event.kind == Kind.LEGS_STOPPED)
    assert (told.legs, told.cause, told.source_id) == ((1,), Cause.COMMAND, second.zid)
    ended = happened.wait(lambda event: event.kind == Kind.LEGS_STOPPED and event is not told)
    assert (ended.legs, ended.source_id) == ((4,), first.zid), "the end of its stream"


def test_an_emergency_stop_names_who_stopped_which_legs(two: tuple[Client, Client]) -> None:
    first, second = two
    happened = events(first)
    first.start_leg(2, *POSE)
    second.estop("bert")
    told = happened.wait(lambda event: event.kind == Kind.LEGS_STOPPED)
    assert (told.legs, told.cause, told.source, told.source_id) == ((2,), Cause.ESTOP, "bert", second.zid)
    first.reset()


def test_a_rejection_names_the_session_of_its_command(two: tuple[Client, Client]) -> None:
    first, second = two
    happened = events(second)
    first.set_leg(2, *POSE, check=False)
    rejected = happened.wait(lambda event: event.kind == Kind.COMMAND_REJECTED)
    assert (rejected.source, rejected.source_id) == (NAME, first.zid)
