"""The asyncio client: the same names, on a loop that never waits; cancelled at any point, the robot is stopped."""

import asyncio
import gc
import inspect
import re
import threading
from collections.abc import AsyncIterator, Callable
from typing import Any, Final

import pytest

from gateway.client import (
    AsyncButton,
    AsyncClient,
    AsyncLease,
    AsyncStream,
    AsyncWalk,
    Button,
    Client,
    Lease,
    Posture,
    StoppedError,
    Stream,
    Walk,
    ZenohError,
)
from gateway.people.client.aio import Calls
from schemas import keys
from schemas.calibration import ServoChange
from schemas.event import Event
from schemas.words import Kind, Mode, Reason
from tests.support.fixtures import gateway_fixture, patient
from tests.support.gateway_process import Gateway

POSE = (90, 45, 120)
HZ = 50

gateway = gateway_fixture(patient(4000))


@pytest.fixture
async def robot(gateway: Gateway) -> AsyncIterator[AsyncClient]:
    async with AsyncClient(gateway.endpoint, source="async", timeout_s=5) as client:
        await client.reset()
        assert (await client.stop()).accepted
        yield client


async def running(client: AsyncClient) -> list[int]:
    return [leg.leg for leg in (await client.state()).legs if leg.servos[0].running]


def public(kind: type) -> dict[str, list[str]]:
    """Return the methods and properties of programs: each parameter with its type and default."""

    def taken(member: Any) -> list[str]:
        parameters = {} if isinstance(member, property) else inspect.signature(member).parameters
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
def test_client_and_asyncclient_have_the_same_names_and_arguments(twin: type, own: type) -> None:
    wanted = {name: taken for name, taken in public(own).items() if not isinstance(getattr(twin, name, None), property)}
    assert {name: taken for name, taken in public(twin).items() if name in wanted} == wanted
    assert public(own).keys() <= vars(twin).keys()


CALLS: Final[list[tuple[str, tuple[Any, ...], Callable[[Any], object]]]] = [
    ("wait_ready", (), lambda state: state.mode == Mode.IDLE),
    ("start_leg", (3, *POSE), lambda ack: ack.accepted),
    ("set_leg", (3, *POSE), lambda ack: ack.accepted),
    ("start_legs", ({1: POSE, 2: POSE},), lambda ack: ack.accepted),
    ("set_legs", ({1: POSE, 2: POSE},), lambda ack: ack.accepted),
    ("ask", (keys.leg_command(2), {"servos": [{"op": "stop"}] * 3}), lambda ack: ack.accepted),
    ("stop", (), lambda ack: ack.accepted),
    ("calibrate", ({51: ServoChange(min_deg=12.34)},), lambda ack: ack.accepted),
    ("calibration", (), lambda calibration: calibration.servos["51"].min_deg == 12.34),
    ("ask_for_lease", (), lambda ack: ack.reason == Reason.NO_LEASE),
    ("revocation", (), lambda ack: ack.number == 0),
    ("telemetry", (), lambda telemetry: telemetry is None),
    ("estop", (), lambda ack: ack.stop_frames == 6),
    ("state", (), lambda state: state.mode == Mode.ESTOPPED),
    ("reset", (), lambda ack: ack.accepted),
]


async def test_each_call_has_the_answer_of_the_blocking_one(robot: AsyncClient) -> None:
    for name, args, expected in CALLS:
        answer = await getattr(robot, name)(*args)
        assert expected(answer), (name, answer)
    waiting = {name for name in public(AsyncClient) if inspect.iscoroutinefunction(getattr(AsyncClient, name))}
    assert {name for name, *_ in CALLS} == waiting - {"close"}


async def go_on(stream: AsyncStream) -> None:
    async with asyncio.timeout(10):
        while True:
            await stream.set({1: POSE, 6: POSE})


async def test_what_is_used_in_a_with(robot: AsyncClient) -> None:
    events: asyncio.Queue[Event] = asyncio.Queue()
    subscriber = robot.on_event(events.put_nowait)
    async with robot.button("kitchen") as button, robot.lease() as lease, robot.stream(HZ) as stream:
        assert (button.name, (await button.alive()).alive) == ("kitchen", 1)
        assert (lease.held, lease.holder, lease.lost) == (True, "async", None)
        begun_s = asyncio.get_running_loop().time()
        for _ in range(26):
            await stream.set({1: POSE, 6: POSE})
        assert asyncio.get_running_loop().time() - begun_s >= 24 / HZ
        assert await running(robot) == [1, 6]
        await robot.stop(6)
        with pytest.raises(StoppedError, match="leg 6"):
            await go_on(stream)
        stream.start_again()
        await stream.set({6: POSE})
        assert 6 in await running(robot)
        assert (await button.press()).accepted
    async with asyncio.timeout(10):
        while (event := await events.get()).kind != Kind.ESTOP_ENGAGED:
            pass
    assert event.source == "kitchen"
    subscriber.undeclare()
    assert not lease.held
    walk = robot.walk()
    walk.hold_s = 0.25
    assert walk.hold_s == 0.25


async def test_what_open_returns_is_for_the_loop_and_close_stops_it(robot: AsyncClient) -> None:
    stream = await robot.stream(HZ).open()
    await stream.set(dict.fromkeys(range(1, 7), POSE))
    assert await running(robot) == [1, 2, 3, 4, 5, 6]
    await stream.close()
    walk = await robot.walk(hz=HZ).open()
    await walk.stand()
    assert await running(robot) == [1, 2, 3, 4, 5, 6]
    await walk.close()
    assert await running(robot) == []


async def test_a_cancelled_distance_ends_in_a_stand(robot: AsyncClient) -> None:
    async with robot.walk(hz=HZ) as walk:
        walk.hold_s = 0.1
        await walk.stand()
        ahead = asyncio.create_task(walk.ahead(20))
        for posture in (Posture.WALKING, Posture.STANDING):
            async with asyncio.timeout(10):
                while walk.state.posture != posture:
                    await robot.state()
            ahead.cancel()


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


async def test_a_call_that_fails_after_its_cancellation_prints_nothing() -> None:
    cancelled, said, calls = threading.Event(), list[str](), Calls()

    def fail() -> None:
        cancelled.wait(10)
        raise StoppedError("the watchdog stopped leg 1", [1])

    asyncio.get_running_loop().set_exception_handler(lambda _, context: said.append(context["message"]))
    task = asyncio.create_task(calls.run(fail))
    await asyncio.sleep(0)
    task.cancel()
    await asyncio.wait([task])
    cancelled.set()
    await asyncio.to_thread(calls.after_stops(bool))
    del task
    gc.collect()
    assert said == []


async def test_a_client_that_is_not_open_states_what_to_do() -> None:
    with pytest.raises(ZenohError, match="use it in an `async with`"):
        await AsyncClient().state()


async def test_a_stop_does_not_wait_behind_questions_and_closing_waits_for_it(gateway: Gateway) -> None:
    answered, order = threading.Event(), list[str]()

    def stop() -> None:
        answered.wait(10)
        order.append("stopped")

    async with AsyncClient(gateway.endpoint, timeout_s=5) as client:
        calls = client._calls
        pending = [asyncio.create_task(calls.run(lambda: answered.wait(10))) for _ in range(40)]
        await asyncio.sleep(0)  # now all are asked
        async with asyncio.timeout(5):
            assert (await client.stop(3)).accepted
        stopping = asyncio.create_task(calls.run(stop, stops=True))
        await asyncio.sleep(0)
        stopping.cancel()
        await asyncio.wait([stopping])
        closing = asyncio.create_task(asyncio.to_thread(calls.after_stops(lambda: order.append("closed"))))
        await asyncio.wait([closing], timeout=0.1)
        answered.set()
        await asyncio.gather(closing, *pending)
    assert order == ["stopped", "closed"]


async def test_closing_ends_although_it_is_cancelled_before_a_thread_takes_it() -> None:
    calls, stopped, closed = Calls(), threading.Event(), threading.Event()
    stopping = asyncio.create_task(calls.run(lambda: stopped.wait(10), stops=True))
    await asyncio.sleep(0)
    closing = asyncio.create_task(calls.run(calls.after_stops(closed.set)))
    await asyncio.sleep(0)
    closing.cancel()
    await asyncio.wait([closing])
    stopped.set()
    await stopping
    assert await asyncio.to_thread(closed.wait, 10)
