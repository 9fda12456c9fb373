"""What a gateway publishes, on its way to an event loop, and which gateway it is."""

import asyncio
import threading
from queue import SimpleQueue
from typing import Any, cast

import zenoh

from gateway.client import Client
from gateway.people.client.subscriptions import KEPT_EVENTS
from gateway.people.watching.live import Live, OnLoop, Receiver
from schemas.telemetry import GatewayState, Kind, Telemetry
from tests.support.published import WALL, event, state

# ---- to an event loop


class OnThisLoop(Receiver):
    """Keeps what it is called with."""

    def __init__(self) -> None:
        self.calls: list[tuple[object, ...]] = []

    def __getattribute__(self, name: str) -> Any:
        found = super().__getattribute__(name)
        return (lambda *arguments: self.calls.append((name, *arguments))) if callable(found) else found


def test_a_busy_loop_gets_the_newest_state_and_a_bounded_number_of_events() -> None:
    async def busy() -> list[tuple[object, ...]]:
        receiver = OnThisLoop()
        to_loop = OnLoop(asyncio.get_running_loop(), receiver)

        def flood() -> None:
            to_loop.opened()
            for number in range(KEPT_EVENTS + 3):
                to_loop.received_state(state(float(number)), number)
                to_loop.received_event(event(Kind.STOPPING, str(number)))
                to_loop.received_telemetry(Telemetry(time=WALL, age_ms=0.0, tilt_deg=number))
            to_loop.received_token(False)
            to_loop.diagnosed(["nobody is there"])

        thread = threading.Thread(target=flood)
        thread.start()
        thread.join()  # the loop does nothing meanwhile
        await asyncio.sleep(0)
        to_loop.received_token(True)
        await asyncio.sleep(0)
        return receiver.calls

    last = KEPT_EVENTS + 2
    assert asyncio.run(busy()) == [
        ("opened",),
        ("received_state", state(float(last)), last),
        *(("received_event", event(Kind.STOPPING, str(each)), 3 if each == 3 else 0) for each in range(3, last + 1)),
        ("received_telemetry", Telemetry(time=WALL, age_ms=0.0, tilt_deg=last)),
        ("received_token", False),
        ("diagnosed", ["nobody is there"]),
        ("received_token", True),
    ]


# ---- a connection that stays


class BreaksAtOnce:
    """A client whose link breaks before its session has a subscription."""

    def __init__(self, closed: "SimpleQueue[BreaksAtOnce]") -> None:
        self.session = self
        self._closed = closed

    def declare_subscriber(self, _key: str, _ring: object) -> None:
        raise zenoh.ZError("the link is broken")

    def state(self, _timeout_s: float) -> GatewayState:
        raise zenoh.ZError("the link is broken")

    def close(self) -> None:
        self._closed.put(self)


def test_a_session_without_subscriptions_is_closed_before_the_next_is_opened() -> None:
    opened: SimpleQueue[BreaksAtOnce] = SimpleQueue()
    closed: SimpleQueue[BreaksAtOnce] = SimpleQueue()

    def connect() -> Client:
        opened.put(client := BreaksAtOnce(closed))
        return cast(Client, client)

    live = Live(connect, OnThisLoop(), lambda _: [])
    live.start()
    for _ in range(2):
        assert opened.get(timeout=10) is closed.get(timeout=10)
    live.close()
