"""Programs that share a robot: who did it, and what stopped. Programs without our client, at any rate."""

import json
import os
import subprocess
import sys
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Final

import pytest

from gateway.client import Client, LeaseError, StoppedError, Stream
from schemas import keys
from schemas.gateway_state import GatewayState
from schemas.robot import LEGS
from schemas.words import Cause, Kind
from tests.support.child import Child
from tests.support.fixtures import gateway_fixture, patient
from tests.support.gateway_process import Gateway
from tests.support.heard import events, frames, last_angles, states
from tests.support.waiting import wait_until

POSE = (90.0, 45.0, 120.0)
NAME = "my gait"
gateway = gateway_fixture(patient(4000))


@pytest.fixture
def two(gateway: Gateway) -> Iterator[tuple[Client, Client]]:
    """Yield two programs of one name."""
    with Client(gateway.endpoint, source=NAME) as first, Client(gateway.endpoint, source=NAME) as second:
        yield first, second


@contextmanager
def started(client: Client) -> Iterator[Stream]:
    """Return a stream that has started leg 1."""
    with client.stream(50) as stream:
        stream.set({1: POSE})
        yield stream


def hold(*streams: Stream) -> None:
    """Set leg 1 by these streams in turns, for a second."""
    for _ in range(50):
        for each in streams:
            each.set({1: POSE})


def test_two_programs_of_one_name_are_told_apart(two: tuple[Client, Client]) -> None:
    """Each is warned if another program of its name takes its leg. States and events name both sessions."""
    first, second = two
    happened = events(first)
    with first.stream(50, lease=False) as one, second.stream(50, lease=False) as other:
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


@pytest.mark.parametrize("kind", ["stream", "walk"])
def test_a_stream_and_a_walk_hold_the_lease_while_they_drive(two: tuple[Client, Client], kind: str) -> None:
    """A second program of the same name is rejected, by name; it drives once the first has ended."""
    first, second = two

    def drives(client: Client) -> AbstractContextManager[object]:
        return client.walk() if kind == "walk" else started(client)

    with drives(first):
        assert first.state().lease.holder == NAME
        with pytest.raises(LeaseError, match="the lease is held by another program named 'my gait'"), drives(second):
            pass
        assert not second.set_leg(1, *POSE, check=False).accepted
    assert first.state().lease.holder is None
    with drives(second):
        assert second.state().lease.holder == NAME


def test_a_stream_that_waits_for_a_reset_leaves_the_lease_to_whoever_resets(two: tuple[Client, Client]) -> None:
    first, second = two
    engaged = events(second)
    with started(first) as stream:
        second.estop("bert")
        with pytest.raises(StoppedError) as stopped:
            hold(stream)
        assert stopped.value.cause == Kind.ESTOP_ENGAGED
        engaged.wait(lambda event: event.kind == Kind.ESTOP_ENGAGED)
        assert not second.reset(check=False).accepted
        with ThreadPoolExecutor(1) as thread:
            recovers = thread.submit(stream.recover, timeout_s=20)
            engaged.wait(lambda event: event.kind == Kind.LEASE_RELEASED)
            second.reset()
            recovers.result()
        stream.set({1: POSE})
        assert first.state().lease.holder == NAME


def test_a_second_program_with_the_same_zenoh_id_can_stop_the_robot(gateway: Gateway, tmp_path: Path) -> None:
    file = tmp_path / "copied.json5"
    file.write_text(json.dumps({"id": "ab12", "connect": {"endpoints": [gateway.endpoint]}}))
    with Client(zenoh_config=file) as first:
        with pytest.warns(UserWarning, match="does not admit the Zenoh id ab12"):
            second = Client(zenoh_config=file)
        with second:
            assert first.zid == "ab12" != second.zid
            assert second.estop().accepted
            second.reset()


def test_the_fork_of_a_program_cannot_use_its_client(gateway: Gateway) -> None:
    """Zenoh's threads stay with the parent; a session in the child crashed the parent."""
    program = f"""
import os
from gateway.client import Client, ZenohError
with Client({gateway.endpoint!r}) as robot, robot.stream(50) as stream:
    stream.set({{1: {POSE}}})
    if os.fork() == 0:
        for call in (robot.state, lambda: Client({gateway.endpoint!r}), robot.close):
            try:
                call()
                print("no error", flush=True)
            except ZenohError as error:
                print(error, flush=True)
        os._exit(0)
    os.wait()
    stream.set({{1: {POSE}}})
    print(robot.state().leg(1).running, flush=True)
"""
    with Child([sys.executable, "-c", program], os.environ) as child:
        assert child.wait(20) == 0, child.stderr
    *refused, closed, runs = child.stdout.splitlines()
    assert [text.partition(",")[0] for text in refused] == [
        "this process is the fork of one that has opened a client"
    ] * 2
    assert (closed, runs) == ("no error", "True")


DROPPED: Final = {
    "lease": "lease = robot.lease(); lease.acquire()",
    "stream": "stream = robot.stream(); stream.open(); stream.set({1: (90, 45, 120)})",
    "walk": "walk = robot.walk().open()",
    "walk that stands": "walk = robot.walk().open(); walk.stand()",
    "walk that failed": """
walk = robot.walk().open()
try:
    robot.walk().open()
except RuntimeError:
    pass
""",
    "asyncio, lease": "asyncio.run(leases())",
    "asyncio, stream": "asyncio.run(streams())",
    "asyncio, walk": "asyncio.run(walks())",
}


@pytest.mark.parametrize("drives", DROPPED)
def test_a_program_that_drops_its_client_renews_no_lease_and_can_end(gateway: Gateway, drives: str) -> None:
    program = f"""
import asyncio, gc
from gateway.client import AsyncClient, Client
gc.disable()
async def client():
    robot = AsyncClient({gateway.endpoint!r}, source="dropped")
    return await robot.__aenter__()
async def leases():
    await (await client()).lease().__aenter__()
async def streams():
    stream = await (await client()).stream().open()
    await stream.set({{1: (90, 45, 120)}})
async def walks():
    await (await (await client()).walk().open()).stand()
robot = Client({gateway.endpoint!r}, source="dropped")
robot.on_state(lambda state: None)
{DROPPED[drives]}
lease = stream = walk = robot = None
print("dropped", flush=True)
input()
"""
    with gateway.client() as watcher, Child([sys.executable, "-c", program], os.environ) as child:
        told = events(watcher)
        child.wait_for_output("dropped")
        ended = told.wait(lambda event: event.kind in (Kind.LEASE_EXPIRED, Kind.LEASE_RELEASED))
        assert ended.source == "dropped"
        wait_until(lambda: not any(leg.running for leg in watcher.state().legs), "rest", 20)
        child.tell("")
        assert child.wait(20) == 0, child.stderr


@pytest.mark.parametrize("kind", ["stream", "walk"])
def test_a_closed_stream_or_walk_raises_an_error_that_says_so(two: tuple[Client, Client], kind: str) -> None:
    first, _ = two
    part = first.stream(50) if kind == "stream" else first.walk()
    use = partial(part.set, {1: POSE}) if isinstance(part, Stream) else part.go
    with pytest.raises(RuntimeError, match="is used in a `with`"):
        use()
    part.open()
    part.close()
    with pytest.raises(RuntimeError, match=f"this {kind} is closed"):
        use()


def test_a_stop_by_another_program_of_the_same_name_is_not_this_programs(two: tuple[Client, Client]) -> None:
    first, second = two
    happened = events(second)
    with warnings.catch_warnings(action="ignore"), first.stream(50, lease=False) as one:
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


# ---- ordinary programs without `sent_ms`: each message is taken, and each leg moves


LEG: Final = {"servos": [{"op": "OP", "angle_deg": angle_deg} for angle_deg in (90, 45, 120)]}
SENT: Final[dict[str, dict[str, object]]] = {
    "legs": {keys.LEGS_COMMAND: {"legs": {str(leg): LEG for leg in LEGS}}},
    "one leg": {keys.leg_command(1): LEG},
    "six legs": {keys.leg_command(leg): LEG for leg in LEGS},
    "a servo": {keys.servo_command(11): LEG["servos"][0]},
}
"""The payload on each key; OP becomes `start` or `set`."""
SENDS: Final = """
import json, sys, time, zenoh

endpoint, rate_hz, verb, express, sent = json.loads(sys.argv[1])
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([endpoint]))
with zenoh.open(config) as session:
    puts, gets = 0, []
    for number in range(rate_hz):
        for key, (start, then) in sent.items():
            payload = then if number else start
            if verb == "put":
                session.put(key, payload, express=express, congestion_control=zenoh.CongestionControl.BLOCK)
                puts += 1
            else:
                gets.append(session.get(key, payload=payload))
        time.sleep(1 / rate_hz)
    list(session.get("hexapod/state"))  # behind all puts: none is lost at the session's end
    print(puts + sum(len(list(replies)) for replies in gets))  # a get that others displaced has none
"""


def counts(state: GatewayState) -> tuple[int, ...]:
    commands = state.commands
    return commands.accepted, commands.rejected, commands.passed_over, commands.lost


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "rate_hz", "then", "verb", "express"),
    [
        ("legs", 200, "set", "put", False),
        ("legs", 1000, "start", "get", True),
        ("one leg", 50, "start", "put", True),
        ("one leg", 300, "set", "get", False),
        ("one leg", 1000, "set", "put", True),
        ("six legs", 50, "set", "get", False),
        ("six legs", 200, "start", "put", False),
        ("six legs", 300, "set", "put", True),
        ("a servo", 200, "start", "get", False),
        ("a servo", 1000, "set", "put", False),
    ],
)
def test_a_stream_of_any_rate_moves_the_robot(
    tmp_path: Path, name: str, rate_hz: int, then: str, verb: str, express: bool
) -> None:
    """A second of it is sent. `coalesced` shows that it is thinned to the rate of the legs, not refused."""
    sent = {key: [json.dumps(each).replace("OP", op) for op in ("start", then)] for key, each in SENT[name].items()}
    settings: dict[str, dict[str, object]] = {"telemetry": {"frames": True}, "watchdog": {"timeout_ms": 2000}}
    with Gateway(tmp_path, settings) as gateway, gateway.client() as watcher:
        heard, counted = frames(watcher), states(watcher, kept=20)
        argument = json.dumps([gateway.endpoint, rate_hz, verb, express, sent])
        count = int(subprocess.check_output([sys.executable, "-c", SENDS, argument], timeout=60))
        counted.wait(lambda state: sum(counts(state)) == count)
        assert watcher.state().commands.rejected == 0
        legs = set(LEGS) if "legs" in name else {1}
        heard.wait_for_all(lambda records: {servo_id // 10 for servo_id in last_angles(records)} == legs)
        assert watcher.state().commands.coalesced > 0 or rate_hz == 50
