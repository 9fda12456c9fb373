"""Who is driving: each rule of the lease, judged by the oracle as well."""

import pytest

from gateway.robot.core.events import Do, LeaseRequest, RequestAnswer
from gateway.robot.core.lease import MOST_ASKERS, RobotLease
from gateway.robot.core.leg import Rules
from gateway.robot.core.supervisor import Supervisor
from schemas.telemetry import Kind
from tests.support.steps import Steps, all_stopped, leg_to, servo_to

ANNA, BERT, CARL = "a" * 32, "b" * 32, "c" * 32
GRANTED = "granted"
ACQUIRED = ["announce lease_acquired", GRANTED]
START, SET, STOP = leg_to(1, "start 90"), leg_to(1, "set 45"), leg_to(1, "stop")


def driven_by_anna(rules: Rules | None = None) -> Steps:
    """Anna holds the lease since 0 ms, and leg 1 runs."""
    robot = Steps(rules)
    assert robot.lease(0, "acquire anna", fresh=ANNA) == ACQUIRED
    assert robot.command(1, START, lease=ANNA) == ["command 1 start 90", "completed 1"]
    return robot


def told(robot: Steps) -> list[tuple[Kind, str | None, str]]:
    return [(each.kind, each.source, each.detail) for each in robot.announced]


# ---- free


def test_a_token_is_rejected_while_it_is_free_and_stops_are_not() -> None:
    """It may be that of somebody whose lease was taken, and has been released since."""
    robot = Steps()
    assert robot.command(1, START, lease=ANNA) == ["rejected 1 not_holder"]
    assert robot.command(2, STOP, lease=ANNA) == ["command 1 stop", "completed 2"]
    robot.estop(3)
    assert robot.reset(4, lease=ANNA) == ["rejected 3 not_holder"]
    assert robot.lease(5, "ask bert") == ["no_lease"]


def test_where_it_is_required_nothing_moves_without_it() -> None:
    robot = Steps(Rules(repeats=0, lease_required=True))
    assert robot.command(1, START) == ["rejected 1 no_lease"]
    assert robot.command(2, STOP) == ["command 1 stop", "completed 2"]
    robot.estop(3)
    assert robot.reset(4) == ["announce estop_reset", "completed 3"], "a reset moves nothing"
    robot.lease(5, "acquire anna", fresh=ANNA)
    assert robot.command(6, START, lease=ANNA) == ["command 1 start 90", "completed 4"]
    robot.lease(7, "release", ANNA)
    assert robot.command(30, SET) == ["rejected 5 no_lease"]


# ---- held


@pytest.mark.parametrize("token", [None, BERT, ANNA[:-1] + "0"])
def test_only_its_holder_moves_and_resets_and_everybody_stops(token: str | None) -> None:
    robot = driven_by_anna()
    assert robot.command(30, SET, lease=token) == ["rejected 2 not_holder"]
    assert robot.command(30, leg_to(2, "start 90"), lease=token) == ["rejected 3 not_holder"]
    assert robot.command(31, servo_to(11, "stop"), lease=token) == ["command 11 stop", "completed 4"]
    assert robot.command(32, leg_to(1, "stop", "set 1", "set 1"), lease=token) == [
        "command 11 stop",
        "rejected 5 not_holder stopped",
    ]
    assert robot.estop(33) == [*all_stopped("estop"), "announce estop_engaged"]
    assert robot.reset(34, lease=token) == ["rejected 6 not_holder"]
    assert robot.reset(35, lease=ANNA) == ["announce estop_reset", "completed 7"]


def test_a_rejection_names_the_holder() -> None:
    robot = driven_by_anna()
    for token, detail in (
        (None, "anna holds the lease"),
        (BERT, "the command's own lease has ended, and anna holds the lease"),
    ):
        robot.command(30, SET, lease=token)
        assert [effect.detail for effect in robot.effects if hasattr(effect, "detail")] == [detail]


# ---- time


def test_silence_loses_it_in_its_ttl_and_the_legs_are_the_watchdogs_affair() -> None:
    robot = driven_by_anna()
    assert robot.time(251) == ["watchdog 1 stop", "announce watchdog_expired"]
    assert robot.due_ms == 1001
    assert robot.time(1001) == ["announce lease_expired"]
    assert told(robot) == [(Kind.LEASE_EXPIRED, "anna", "anna was silent for 1000 ms and has lost the lease")]
    assert robot.command(1002, START, lease=ANNA) == ["rejected 2 not_holder"]
    assert robot.lease(1003, "renew", ANNA) == ["not_holder"]
    assert robot.lease(1004, "acquire bert", fresh=BERT) == ACQUIRED


@pytest.mark.parametrize("kept", ["renew", "set", "stop", "reset"])
def test_whatever_of_its_holder_is_accepted_keeps_it(kept: str) -> None:
    robot = driven_by_anna(Rules(repeats=0, timeout_ns=10_000_000_000, rest_ns=10_000_000_000))
    if kept == "renew":
        assert robot.lease(900, "renew", ANNA) == [GRANTED]
    elif kept == "reset":
        assert robot.reset(900, lease=ANNA) == ["completed 2"]
    else:
        robot.command(900, STOP if kept == "stop" else SET, lease=ANNA)
    assert robot.time(1001) == []
    assert robot.due_ms == 1900
    assert robot.time(1900) == ["announce lease_expired"]


def test_a_command_that_comes_after_its_ttl_does_not_save_it() -> None:
    robot = driven_by_anna(Rules(repeats=0, timeout_ns=10_000_000_000, rest_ns=10_000_000_000))
    assert robot.command(1001, SET, lease=ANNA) == ["announce lease_expired", "rejected 2 not_holder"]
    assert robot.lease(1002, "release", ANNA) == ["not_holder"]


# ---- asked, released, handed over


def test_whoever_asks_is_told_of_and_changes_nothing() -> None:
    robot = driven_by_anna()
    assert robot.lease(2, "ask bert") == ["announce lease_asked", GRANTED]
    assert told(robot) == [(Kind.LEASE_ASKED, "bert", "bert asks anna for the lease")]
    assert robot.supervisor.lease.asked_by == "bert"
    robot.lease(3, "ask carl")
    assert robot.supervisor.lease.asked_by == "carl"
    robot.lease(4, "ask bert")
    assert robot.supervisor.lease.asked_by == "bert"
    assert robot.command(30, SET, lease=ANNA) == ["command 1 set 45", "completed 2"]


def test_a_handover_goes_to_one_who_has_asked_and_the_legs_go_on() -> None:
    robot = driven_by_anna()
    assert robot.lease(2, "release to bert", ANNA) == ["lease_denied"], "he has not asked"
    robot.lease(3, "ask bert")
    assert robot.lease(4, "release to nobody", ANNA) == ["lease_denied"]
    assert robot.command(30, SET, lease=ANNA) == ["command 1 set 45", "completed 2"], "it is still hers"
    assert robot.lease(31, "release to bert", ANNA) == ["announce lease_released", GRANTED]
    assert robot.supervisor.lease.holder == "bert"
    for token in (ANNA, BERT, None):
        assert robot.command(60, SET, lease=token)[0].endswith("not_holder")
    assert robot.lease(61, "acquire carl", fresh=CARL) == ["lease_held"]
    assert robot.lease(61, "ask carl") == ["lease_held"]
    assert robot.lease(62, "acquire bert", fresh=BERT) == ACQUIRED
    assert robot.command(63, SET, lease=BERT) == ["command 1 set 45", "completed 6"]


def test_a_handover_that_nobody_comes_for_frees_it_after_the_ttl() -> None:
    robot = driven_by_anna()
    robot.lease(2, "ask bert")
    robot.lease(3, "release to bert", ANNA)
    robot.time(251)
    assert robot.time(1003) == ["announce lease_expired"]
    assert robot.command(1004, START) == ["command 1 start 90", "completed 2"]


def test_few_askers_are_remembered_the_latest() -> None:
    robot = driven_by_anna()
    for number in range(MOST_ASKERS + 1):
        robot.lease(2, f"ask person {number}")
    assert robot.lease(3, "release to person 0", ANNA) == ["lease_denied"]
    assert robot.lease(3, "release to person 1", ANNA) == ["announce lease_released", GRANTED]


@pytest.mark.parametrize("verified", [False, True])
def test_whether_a_name_is_verified_goes_with_it(verified: bool) -> None:
    robot = driven_by_anna()
    lease = robot.supervisor.lease
    robot.take(2, LeaseRequest(Do.ASK, "bert", verified))
    assert not lease.verified, "anna's is not"
    robot.lease(3, "release to bert", ANNA)
    assert lease.verified is verified
    robot.lease(3, "acquire carl", fresh=CARL)
    assert (robot.only(RequestAnswer).detail, lease.verified) == ("the lease is handed over to bert", verified)
    robot.take(4, LeaseRequest(Do.ACQUIRE, "bert", verified, fresh_token=BERT))
    assert lease.verified is verified
    robot.lease(5, "release", BERT)
    assert not lease.verified


# ---- taken


def test_a_takeover_stops_all_six_legs_first() -> None:
    robot = driven_by_anna()
    robot.command(2, SET, lease=ANNA)
    taken = robot.lease(3, "take bert", fresh=BERT)
    assert taken == [*all_stopped("command"), "rejected 2 not_holder", "announce lease_taken", GRANTED]
    assert robot.only(RequestAnswer).token == BERT
    assert told(robot) == [(Kind.LEASE_TAKEN, "bert", "bert has stopped all legs and taken the lease from anna")]
    assert robot.command(30, START, lease=ANNA) == ["rejected 3 not_holder"]
    assert robot.command(31, SET, lease=BERT) == ["rejected 4 servo_stopped"]
    assert robot.command(32, START, lease=BERT) == ["command 1 start 90", "completed 5"]
    assert robot.command(60, STOP, lease=ANNA) == ["command 1 stop", "completed 6"]


def test_a_former_holders_queue_moves_nothing_once_the_lease_is_free_again() -> None:
    robot = driven_by_anna()
    robot.lease(2, "take bert", fresh=BERT)
    robot.lease(3, "release", BERT)
    assert robot.command(30, START, lease=ANNA) == ["rejected 2 not_holder"]
    assert robot.command(31, START, lease=BERT) == ["rejected 3 not_holder"]


def test_a_takeover_stops_all_legs_also_where_nobody_holds_it_or_it_is_handed_over() -> None:
    robot = Steps()
    assert robot.lease(1, "take bert", fresh=BERT) == [*all_stopped("command"), *ACQUIRED]
    robot = driven_by_anna()
    robot.lease(2, "ask bert")
    robot.lease(3, "release to bert", ANNA)
    assert robot.lease(4, "take carl", fresh=CARL) == [*all_stopped("command"), "announce lease_taken", GRANTED]
    assert robot.lease(5, "acquire bert", fresh=BERT) == ["lease_held"]


def test_its_end_without_a_supervisor() -> None:
    lease, legs = RobotLease(Rules(lease_ttl_ns=100)), Supervisor(Rules()).legs
    assert (lease.verified, lease.due_ns) == (False, None)
    lease.grant(LeaseRequest(Do.ACQUIRE, "anna", fresh_token=ANNA), 0)
    assert lease.expire(99, legs) == []
    lease.grant(LeaseRequest(Do.ASK, "bert"), 50)
    assert (len(lease.expire(100, legs)), lease.holder, lease.asked_by) == (1, None, None)


# ---- the table, and secrets


def test_no_repr_shows_a_token() -> None:
    robot = driven_by_anna()
    seen = [*robot.effects, *robot.lease(2, "renew", ANNA), robot.supervisor.lease]
    robot.lease(3, "take bert", fresh=BERT)
    seen += [*robot.effects, robot.only(RequestAnswer)]
    for each in seen:
        assert ANNA not in repr(each)
        assert BERT not in repr(each)


def test_a_request_at_the_end_delays_no_repeated_stop() -> None:
    robot = Steps(Rules(repeats=1))
    robot.end(0)
    assert robot.lease(20, "acquire anna", fresh=ANNA) == [*all_stopped("repeat"), "stopping"]


@pytest.mark.parametrize(
    ("words", "token", "stops"),
    [("renew", ANNA, ["watchdog 1 stop"]), ("take bert", None, all_stopped("command"))],
)
def test_what_is_asked_just_when_a_leg_is_to_be_stopped_delays_no_stop_and_doubles_none(
    words: str, token: str | None, stops: list[str]
) -> None:
    robot = driven_by_anna()
    said = robot.lease(251, words, token, fresh=BERT)
    assert [line for line in said if line.endswith("stop")] == stops


def test_the_end_of_the_service_ends_it() -> None:
    robot = driven_by_anna()
    robot.end(2)
    assert robot.supervisor.lease.holder is None
    assert robot.due_ms is None
    assert robot.lease(3, "take bert", fresh=BERT) == ["stopping"]


def test_what_others_had_waiting_is_dropped_for_a_new_holder() -> None:
    robot = Steps()
    robot.command(1, leg_to(3, "start 90"))
    assert robot.command(2, leg_to(3, "set 95")) == [], "it waits for its rate slot"
    assert robot.lease(3, "acquire anna", fresh=ANNA)[0] == "rejected 2 not_holder"
