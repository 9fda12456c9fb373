"""The asyncio client: the same names, on a loop that never waits; cancelled at any point, the robot is stopped."""

import asyncio
import inspect
import re
import subprocess
import sys
import threading
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from gateway.client import (
    AsyncButton,
    AsyncClient,
    AsyncLease,
    AsyncStream,
    AsyncWalk,
    Button,
    Client,
    DisconnectedError,
    Lease,
    StoppedError,
    Stream,
    Walk,
)
from gateway.errors import ZenohError
from gateway.people.client.aio import MAX_CALLS
from gateway.people.client.subscriptions import KEPT_EVENTS
from gateway.people.client.twin import CallThreads
from schemas import keys
from schemas.telemetry import Event, Kind, Mode, Telemetry
from tests.support.fixtures import gateway_fixture, patient
from tests.support.gateway_process import Gateway, free_port
from tests.support.measuring import MEASURED, measuring

POSE = (90, 45, 120)
HZ = 50


gateway = gateway_fixture(patient(1000))


@pytest.fixture
async def robot(gateway: Gateway) -> AsyncIterator[AsyncClient]:
    async with AsyncClient(gateway.endpoint, source="async", timeout_s=5) as client:
        await client.reset()
        assert (await client.stop()).accepted
        yield client


async def running(client: AsyncClient) -> list[int]:
    return [leg.leg for leg in (await client.state()).legs if leg.servos[0].running]


def public(kind: type) -> dict[str, list[str]]:
    """The methods and properties of programs: each parameter with its type and default; "value" for a setter."""

    def taken(member: Any) -> list[str]:
        if isinstance(member, property):
            return ["value"] if member.fset else []
        parameters = inspect.signature(member).parameters
        return [re.sub(r"""["']|\b(\w+\.)+""", "", str(parameter)) for parameter in parameters.values()]

    return {
        name: taken(member)
        for name, member in vars(kind).items()
        if not name.startswith("_") and "@private" not in (member.__doc__ or "")
    }


@pytest.mark.parametrize(
    ("twin", "own"),
    [(AsyncClient, Client), (AsyncStream, Stream), (AsyncLease, Lease), (AsyncWalk, Walk), (AsyncButton, Button)],
)
def test_both_have_the_same_names_and_arguments(twin: type, own: type) -> None:
    wanted = public(own)
    assert {name: taken for name, taken in public(twin).items() if name in wanted} == wanted


async def test_each_command_is_there(robot: AsyncClient) -> None:
    assert robot.connected
    assert (await robot.wait_ready()).mode == Mode.IDLE
    assert (await robot.start_leg(3, *POSE)).accepted
    assert (await robot.set_leg(3, *POSE)).accepted
    assert (await robot.start_legs({1: POSE, 2: POSE})).accepted
    assert (await robot.set_legs({1: POSE, 4: POSE})).reason == "servo_stopped"
    assert (await robot.servo(51, "start", 9)).accepted
    assert (await robot.servo(51, "stop")).accepted
    assert (await robot.stop()).accepted
    assert (await robot.estop()).stop_frames == 6
    assert (await robot.reset()).accepted
    assert len(await robot.answerers(keys.RESET)) == 1


async def go_on(stream: AsyncStream) -> None:
    async with asyncio.timeout(10):
        while True:
            await stream.set({1: POSE, 6: POSE})


async def test_a_stream(robot: AsyncClient) -> None:
    loop = asyncio.get_running_loop()
    async with robot.stream(HZ) as stream:
        begun_s = loop.time()
        for _ in range(26):
            await stream.set({1: POSE, 6: POSE})
        assert loop.time() - begun_s >= 24 / HZ
        assert await running(robot) == [1, 6]
        await robot.stop(6)
        with pytest.raises(StoppedError, match="leg 6"):
            await go_on(stream)
        stream.start_again()
        await stream.set({6: POSE})
        assert 6 in await running(robot)
    assert await running(robot) == []


@pytest.mark.parametrize("turns", range(0, 12, 2))
async def test_cancelled_anywhere_it_leaves_nothing_running(gateway: Gateway, robot: AsyncClient, turns: int) -> None:
    """Also in the middle of a start, of the Stop at the end, and twice."""

    async def walk() -> None:
        async with AsyncClient(gateway.endpoint, timeout_s=5) as own, own.stream(HZ) as stream:
            for _ in range(3):
                await stream.set({1: POSE})

    expirations = (await robot.state()).watchdog.expirations
    task = asyncio.create_task(walk())
    for _ in range(turns * 3):
        await asyncio.wait([task], timeout=0.002)
    task.cancel()
    await asyncio.wait([task], timeout=0.001)
    task.cancel()
    await asyncio.wait([task], timeout=10)
    assert task.done()
    async with asyncio.timeout(10):
        while await running(robot):
            pass
    assert (await robot.state()).watchdog.expirations == expirations, "the stream's own Stop has stopped it"


async def test_events_are_kept_until_they_are_read(robot: AsyncClient) -> None:
    found: list[Event] = []
    events = robot.events()
    await robot.state()  # the gateway knows of the subscription
    assert (await robot.start_leg(3, *POSE)).accepted
    async with asyncio.timeout(10):
        async for event in events:
            found.append(event)
            if len(found) == 1:
                await robot.estop()
            else:
                break
    assert [event.kind for event in found] == [Kind.WATCHDOG_EXPIRED, Kind.ESTOP_ENGAGED]
    for _ in range(KEPT_EVENTS + 5):
        events.add(found[0])
    await robot.close()
    assert len([event async for event in events]) == KEPT_EVENTS


async def test_what_the_robot_measures_is_called_back_on_the_loop() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    received: asyncio.Queue[Telemetry] = asyncio.Queue()
    with measuring(endpoint) as robot:
        async with AsyncClient(endpoint, timeout_s=10) as client:
            subscriber = client.watch_telemetry(received.put_nowait)
            assert await client.telemetry() is None
            robot.publish(MEASURED)
            async with asyncio.timeout(10):
                assert await received.get() == await client.telemetry() == MEASURED
            subscriber.undeclare()


async def test_a_stop_does_not_wait_behind_questions(robot: AsyncClient) -> None:
    for _ in range(MAX_CALLS):
        await robot._turns.acquire()  # as if so many were being asked
    question = asyncio.create_task(robot.state())
    async with asyncio.timeout(10):
        assert (await robot.estop()).accepted
        assert (await robot.stop(3)).reason == "estopped"
    assert not question.done()
    robot._turns.release()
    assert (await question).mode == Mode.ESTOPPED


async def test_closing_waits_for_a_stop_that_is_under_way() -> None:
    threads, done = CallThreads(), threading.Event()
    order: list[str] = []

    def stop() -> None:
        done.wait(10)
        order.append("stopped")

    stopping = asyncio.create_task(threads.run(stop, stops=True))
    await asyncio.sleep(0)
    stopping.cancel()
    await asyncio.wait([stopping])
    closing = asyncio.create_task(threads.run_last(lambda: order.append("closed")))
    await asyncio.wait([closing], timeout=0.1)
    done.set()
    await closing
    assert order == ["stopped", "closed"]


async def test_errors_are_the_same(tmp_path: Path) -> None:
    with pytest.raises(ZenohError, match="no gateway answers"):
        async with AsyncClient(f"tcp/127.0.0.1:{free_port()}", timeout_s=0.3):
            pass
    with Gateway(tmp_path) as gateway:
        client = AsyncClient(gateway.endpoint, timeout_s=1)
        with pytest.raises(ZenohError, match="this client is not open"):
            await client.state()
        async with client:
            gateway.child.kill()
            with pytest.raises(DisconnectedError):
                await client.start_leg(3, *POSE)
    assert not client.connected


def test_the_commands_load_neither_asyncio_nor_what_only_a_lease_needs() -> None:
    """A `hexapod-gateway estop` has better use for the time."""
    late = "{'asyncio', 'cryptography', 'schemas.lease', 'gateway.people.tools.driving'}"
    code = f"import sys, gateway.people.tools.send; assert not {late} & set(sys.modules), sys.modules"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0
