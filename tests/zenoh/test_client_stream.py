"""A gait's stream against a real gateway: what it sends, how it ends, and whose legs that end stops."""

import threading
import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from gateway.client import Client, DisconnectedError, RejectedError, StoppedError, Stream
from gateway.model.frames import decode
from schemas.robot import LEGS
from schemas.telemetry import Cause, Event, FrameRecord, Kind, Mode, Reason
from tests.support.cut_link import CutLink
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.gateway_process import Gateway
from tests.support.heard import Heard, events, frames, running, states

HZ = 50
POSE = (90, 45, 120)
MINUTE = timedelta(minutes=1)
TIMEOUT_MS = 1000
"""For setpoints every 20 ms, on a machine that may be busy for longer than the watchdog's 250."""


gateway = gateway_fixture(patient(TIMEOUT_MS, telemetry={"frames": True}, **{"limits.servos.61": {"max_deg": 100}}))
watcher = client_fixture("somebody else", rests=True)
robot = client_fixture(None)
anna = client_fixture("anna", rests=True)
bert = client_fixture("bert")


def go_on(stream: Stream, *legs: int, until: Callable[[], bool] = lambda: False) -> None:
    """Set these legs until it raises, or that holds; for ten seconds at most."""
    end_s = time.monotonic() + 10
    while not until():
        stream.set(dict.fromkeys(legs, POSE))
        assert time.monotonic() < end_s, "nothing has ended it"


def walk(robot: Client, then: Callable[[], object]) -> None:
    """A stream of one leg, in which something happens."""
    with robot.stream(HZ) as stream:
        stream.set({1: POSE})
        then()
        go_on(stream, 1)


def test_the_first_setpoint_of_a_leg_starts_it_and_the_end_stops_what_was_moved(robot: Client, watcher: Client) -> None:
    assert watcher.start_leg(6, *POSE).accepted
    with robot.stream(HZ) as stream:
        stream.set({1: POSE})
        assert 1 in running(watcher)
        stream.set({1: POSE, 4: POSE})
        assert {1, 4} <= set(running(watcher))
        assert watcher.start_leg(6, *POSE).accepted
    assert running(watcher) == [6]


class Timed(Client):
    """Notes when it publishes."""

    sent_s: tuple[float, ...] = ()

    def publish(self, key: str, payload: Mapping[str, Any]) -> None:
        super().publish(key, payload)
        self.sent_s += (time.monotonic(),)


def test_it_keeps_its_pace(gateway: Gateway, watcher: Client) -> None:
    """Every tick is a setpoint's or counted as missed, however busy this machine is."""
    count = 50
    written, rejected = frames(watcher), watcher.state().commands.rejected
    with Timed(gateway.endpoint) as robot, robot.stream(HZ) as stream:
        stream.set({1: POSE})
        begun_s = time.monotonic()
        for step in range(1, count + 1):
            time.sleep(0.005)  # a program has something to compute
            stream.set({1: (90, 45 + step / 10, 120)})
        ticks = count + stream.missed
        sent_s = robot.sent_s
    assert len(sent_s) == count
    # Sleeping for a period after each 5 ms of work would have taken a quarter of a second more.
    assert sent_s[-1] - begun_s == pytest.approx(ticks / HZ, abs=0.15)
    angles = [record for record in written.all if record.cause is Cause.COMMAND]
    assert count / 2 < len(angles) <= count + 2
    assert watcher.state().commands.rejected == rejected


def test_a_program_that_stalls_sends_nothing_and_is_told(gateway: Gateway, watcher: Client) -> None:
    happened, reported, written = events(watcher), states(watcher), frames(watcher)
    with Timed(gateway.endpoint) as robot, robot.stream(HZ) as stream:
        go_on(stream, 1, 2, until=lambda: len(written.all) > 20)
        sent_s = robot.sent_s
        happened.wait(lambda event: event.kind == Kind.WATCHDOG_EXPIRED, count=2)
        before = watcher.state().commands
        seen = len(reported.all)
        reported.wait(lambda _: True, count=seen + 5)  # half a second
        after = watcher.state()
        assert robot.sent_s == sent_s
        assert (after.commands.accepted, after.commands.rejected) == (before.accepted, before.rejected)
        assert after.mode == Mode.IDLE
        for _ in range(2):  # it does not go on by itself
            with pytest.raises(StoppedError, match="1000 ms") as error:
                stream.set({1: POSE, 2: POSE})
            assert error.value.legs == (1, 2), "each leg's event is reported, and both are united"
        assert watcher.state().commands.rejected == before.rejected
        assert not running(watcher)
        stream.start_again()
        stream.set({2: POSE})
        assert running(watcher) == [2]
        for _ in range(10):
            stream.set({2: POSE})


def test_another_ones_stop_ends_it(robot: Client, watcher: Client) -> None:
    with robot.stream(HZ) as stream:
        go_on(stream, 1, 2, until=lambda: running(watcher) == [1, 2])
        watcher.stop(1)
        with pytest.raises(StoppedError, match="somebody else stopped leg 1") as error:
            go_on(stream, 1, 2)
        assert error.value.legs == (1,)
        assert watcher.start_leg(1, *POSE).accepted
        with pytest.raises(StoppedError, match="somebody else stopped leg 1"):
            stream.set({1: POSE, 2: POSE})  # that it runs again is not this program's decision
        watcher.stop(1)


def expired(at: datetime, detail: str, *legs: int) -> Event:
    """The watchdog has stopped these."""
    return Event(time=at, kind=Kind.WATCHDOG_EXPIRED, source=None, key=None, reason=None, detail=detail, legs=legs)


def test_what_ended_before_the_start_is_over(robot: Client) -> None:
    """Events and answers come on ways of their own, and an older event may come later."""
    before = robot.state().time
    with robot.stream(HZ) as stream:
        stream.set({1: POSE})
        stream._receive_event(expired(before, "one leg is stopped", 1))
        stream.set({1: POSE})
        stream._receive_event(expired(before + MINUTE, "one leg is stopped", 1))
        with pytest.raises(StoppedError, match="one leg is stopped") as error:
            stream.set({1: POSE})
        assert error.value.legs == (1,)


def test_whose_stop_it_is_is_read_from_its_legs_and_not_from_its_sentence(robot: Client) -> None:
    with robot.stream(HZ) as stream:
        stream.set({1: POSE})
        later = robot.state().time + MINUTE
        stream._receive_event(expired(later, "leg 1, leg 1, servo 11", 2, 3))
        stream.set({1: POSE})
        stream._receive_event(expired(later, "an older gateway: leg 1"))
        stream.set({1: POSE})  # the gateway is asked, and the leg runs
        stream._receive_event(expired(later, "leg 6 was silent", *LEGS))
        with pytest.raises(StoppedError, match="leg 6 was silent"):
            stream.set({1: POSE})


@pytest.mark.parametrize("holder", ["leg 6", "servo 61"])
def test_a_lease_holder_named_like_a_leg_makes_no_stream_deaf(gateway: Gateway, robot: Client, holder: str) -> None:
    with gateway.client(source=holder) as other, robot.stream(HZ) as stream:
        stream.set({1: POSE})
        with other.lease():
            begun_s = time.monotonic()
            with pytest.raises(RejectedError, match=f"{holder} holds the lease") as error:
                go_on(stream, 1)
            assert error.value.reason == Reason.NOT_HOLDER
            assert time.monotonic() - begun_s < TIMEOUT_MS / 1000, "before the watchdog stops the leg"


def test_messages_that_were_lost_are_not_somebody_elses_stop(robot: Client) -> None:
    """The answer may come before the event: what has stopped the leg is then waited for."""
    with robot.stream(HZ) as stream:
        stream.set({1: POSE})
        state = robot.state()
        servos = tuple(servo.model_copy(update={"running": False}) for servo in state.legs[0].servos)
        leg = state.legs[0].model_copy(update={"servos": servos, "source": None})
        stopped = state.model_copy(update={"legs": (leg, *state.legs[1:])})
        lost = expired(state.time + MINUTE, "messages were lost", 1).model_copy(update={"kind": Kind.OVERFLOW})
        timer = threading.Timer(0.02, stream._receive_event, [lost])
        timer.start()
        error = stream._stopped(stopped)
        timer.join()
        assert str(error).startswith("messages were lost")
        assert error.legs == (1,)


def test_the_emergency_stop_ends_it_and_a_reset_alone_moves_nothing(robot: Client, watcher: Client) -> None:
    with robot.stream(HZ) as stream:
        stream.set({1: POSE})
        number = watcher.estop().estop
        with pytest.raises(StoppedError, match="emergency stop"):
            go_on(stream, 1)
        stream.start_again()
        for _ in range(2):  # a start that was rejected is not tried again by itself
            with pytest.raises(RejectedError, match="rejected: estopped: ") as rejected:
                stream.set({1: POSE})
        assert rejected.value.reason == "estopped"
        assert watcher.reset(number).accepted
        with pytest.raises(RejectedError, match="rejected: estopped: "):
            stream.set({1: POSE})
        assert not running(watcher)
        stream.start_again()
        stream.set({1: POSE})
        assert running(watcher) == [1]


def test_a_setpoint_that_was_rejected_is_reported_and_the_stream_goes_on(robot: Client, watcher: Client) -> None:
    with robot.stream(HZ) as stream, robot.stream(HZ) as other:
        stream.set({6: POSE})
        other.set({5: POSE})
        stream.set({6: (150, 45, 120)})
        with pytest.raises(RejectedError, match="servo 61 may go from 0 to 100 degrees") as error:
            go_on(stream, 6)
        assert error.value.reason == "joint_limit"
        stream.set({6: POSE})
        other.set({5: POSE})
        assert running(watcher) == [5, 6]


def test_a_killed_gateway_is_a_lost_link(tmp_path: Path) -> None:
    with Gateway(tmp_path, patient(TIMEOUT_MS)) as gateway, Client(gateway.endpoint, timeout_s=2) as robot:
        with pytest.raises(DisconnectedError, match="link to the gateway was lost") as error:
            walk(robot, gateway.child.kill)
        assert "no gateway answered" in error.value.__notes__[-1], "the Stop at the end could not be told"
        assert not robot.connected


def test_two_streams_do_not_end_each_other(robot: Client, watcher: Client) -> None:
    happened = events(watcher)
    with robot.stream(HZ) as stalled, robot.stream(HZ) as steady:
        stalled.set({1: POSE})
        steady.set({2: POSE})
        go_on(steady, 2, until=lambda: any(event.kind == Kind.WATCHDOG_EXPIRED for event in happened.all))
        for _ in range(5):
            steady.set({2: POSE})
        with pytest.raises(StoppedError, match="leg 1 was not heard"):
            stalled.set({1: POSE})
        assert running(watcher) == [2]


def test_an_error_of_the_program_stops_the_robot(robot: Client, watcher: Client) -> None:
    with pytest.raises(ZeroDivisionError):
        walk(robot, lambda: 1 // 0)
    assert not running(watcher)


def test_what_is_no_setpoint_is_not_sent(robot: Client, watcher: Client) -> None:
    before = watcher.state().commands.accepted
    with robot.stream(HZ) as stream:
        for wrong in ({7: POSE}, {1: (90, 45)}, {1: (90, 45, 181)}, {1: (90, 45, float("nan"))}, {}):
            with pytest.raises(ValueError, match=r"leg|degrees"):
                stream.set(wrong)
        with pytest.raises(TypeError):
            stream.set({1: (True, 45, 90)})
    with pytest.raises(RuntimeError, match="used in a `with`"):
        stream.set({1: POSE})
    assert watcher.state().commands.accepted == before


def test_a_rate_that_the_watchdog_or_the_limit_would_not_live_with_is_reported(robot: Client) -> None:
    with pytest.raises(ValueError, match="the watchdog stops each leg"):
        robot.stream(1).__enter__()
    for hz in (0, -1, 1001):
        with pytest.raises(ValueError, match="a stream's rate"):
            robot.stream(hz)
    with (
        pytest.warns(UserWarning, match=r"takes 50 setpoints a second .* of 100 Hz it leaves out 50 %"),
        robot.stream(100),
    ):
        pass


def test_ready_is_waited_for(robot: Client, watcher: Client) -> None:
    assert robot.connected
    assert robot.wait_ready().mode == Mode.IDLE
    watcher.estop()
    with pytest.raises(StoppedError, match=r"accepts no commands after 0\.3 s: its mode is estopped"):
        robot.wait_ready(0.3)
    watcher.reset()
    assert robot.wait_ready().mode == Mode.IDLE


def test_two_programs_on_one_leg_without_a_lease_are_both_warned(anna: Client, bert: Client) -> None:
    with anna.stream(HZ) as first, bert.stream(HZ) as second, warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        for _ in range(10 * HZ):
            first.set({1: POSE})
            second.set({1: POSE})
            sentences = [str(each.message) for each in warned]
            if len(sentences) == 2:
                break
    assert sorted(sentence.partition(";")[0] for sentence in sentences) == [
        "leg 1 is commanded by anna, and was by bert",
        "leg 1 is commanded by bert, and was by anna",
    ]


# ---- whose legs the end of a stream stops: its own, also where nobody knows whether they run, and nobody else's


def stops(written: Heard[FrameRecord]) -> list[str]:
    """Stops that somebody commanded."""
    return [
        record.bytes
        for record in written.all
        if record.cause is Cause.COMMAND and decode(bytes.fromhex(record.bytes)).is_stop
    ]


def both_go_on(ends: Stream, its: Iterable[int], goes_on: Stream, others: Iterable[int]) -> None:
    """Set both, until the first raises; for ten seconds at most."""
    for _ in range(10 * HZ):
        ends.set(dict.fromkeys(its, POSE))
        goes_on.set(dict.fromkeys(others, POSE))


def test_a_rejected_bystander_stops_nobody(gateway: Gateway, anna: Client, bert: Client) -> None:
    """One that gives up, and one that does not."""
    with gateway.client() as watcher, anna.lease(), anna.stream(HZ) as stream:
        happened, written = events(watcher), frames(watcher)
        stream.set({1: POSE, 2: POSE})
        with pytest.raises(RejectedError, match="anna holds the lease"), bert.stream(HZ) as rejected:
            rejected.set({1: POSE, 6: POSE})
        with bert.stream(HZ) as rejected:
            for _ in range(3):
                with pytest.raises(RejectedError, match="anna holds the lease"):
                    rejected.set({1: POSE, 6: POSE})
                rejected.start_again()
        for _ in range(10):
            stream.set({1: POSE, 2: POSE})
        assert running(watcher) == [1, 2]
        assert not stops(written)
        assert not [event for event in happened.all if event.kind == Kind.SOURCE_CHANGED]


def test_who_drove_before_a_takeover_stops_nothing_of_the_new_holder(anna: Client, bert: Client) -> None:
    """Without a lease of its own: the takeover stopped its legs, and what runs now is the holder's."""
    with bert.stream(HZ) as before:
        before.set({1: POSE, 2: POSE})
        with anna.lease(take=True), anna.stream(HZ) as stream:
            stream.set({1: POSE, 3: POSE})
            with pytest.raises((RejectedError, StoppedError)):
                both_go_on(before, (1, 2), stream, (1, 3))
            before.close()
            for _ in range(10):
                stream.set({1: POSE, 3: POSE})
            assert running(anna) == [1, 3]


def test_who_is_rejected_while_its_own_legs_run_stops_them(anna: Client, bert: Client) -> None:
    """Somebody acquires the lease while it was free: nothing was stopped, and the legs are still this program's."""
    with anna.stream(HZ) as other, bert.stream(HZ) as stream:
        other.set({4: POSE})
        stream.set({1: POSE})
        with anna.lease():
            with pytest.raises(RejectedError, match="anna holds the lease"):
                both_go_on(stream, (1,), other, (4,))
            assert 1 in running(anna)
            stream.close()
            assert running(anna) == [4]


def test_a_start_that_nobody_answered_is_stopped(gateway: Gateway, anna: Client) -> None:
    """It may still be on its way, and arrive later."""
    written = frames(anna)
    with CutLink(gateway.endpoint) as link, Client(link.endpoint, source="bert", timeout_s=0.3) as bert:
        with bert.stream(HZ) as stream:
            link.hold()
            with pytest.raises(DisconnectedError):
                stream.set({5: POSE})
            link.fix()
            written.wait(lambda record: record.cause is Cause.COMMAND)
        assert running(anna) == []
    assert len(stops(written)) == 1


def test_a_leg_that_somebody_else_stopped_and_started_is_theirs(anna: Client, bert: Client) -> None:
    with bert.stream(HZ) as stream:
        stream.set({1: POSE, 2: POSE})
        assert anna.stop(1).accepted
        with pytest.raises(StoppedError, match="leg 1"):
            go_on(stream, 1, 2)
        assert anna.start_leg(1, *POSE).accepted
    assert running(anna) == [1]
