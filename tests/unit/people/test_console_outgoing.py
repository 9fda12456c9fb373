"""What waits for one page is bounded, and of the state only the newest is sent."""

import json
from datetime import UTC, datetime
from functools import partial
from typing import Any

from gateway.people.console.pages.outgoing import KEPT_MESSAGES, Outgoing
from gateway.people.console.pages.page_messages import AckMessage, EventMessage, LinkMessage, Stopping
from schemas.telemetry import Event


def event(number: int) -> EventMessage:
    return EventMessage(
        event=Event(time=datetime.now(UTC), kind="started", source=None, key=None, reason=None, detail=str(number))
    )


def stopping(number: int, *, answered: bool) -> Stopping:
    return Stopping(id=number, asked_ms_ago=0.0, answered=answered, attempts=0)


async def sent(outgoing: Outgoing) -> list[dict[str, Any]]:
    return [json.loads(text) for text in await outgoing.wait()]


async def test_a_page_that_reads_nothing_costs_a_bounded_amount() -> None:
    outgoing = Outgoing()
    for number in range(1000):
        outgoing.put(event(number))
        outgoing.put(AckMessage(id=number, took_ms=1.0))
        outgoing.put(LinkMessage(status="gone", detail=str(number)))
        outgoing.put(stopping(number % 3, answered=number >= 999))
        outgoing.put_state(partial(json.dumps, {"type": "state", "number": number}))
    messages = await sent(outgoing)
    assert len(messages) == 3 + KEPT_MESSAGES + 1 + 1 + KEPT_MESSAGES
    assert [message["number"] for message in messages if message["type"] == "state"] == [999]
    assert [message["detail"] for message in messages if message["type"] == "link"] == ["999"]
    events = [message for message in messages if message["type"] == "event"]
    assert [message["event"]["detail"] for message in events] == [
        str(number) for number in range(1000 - KEPT_MESSAGES, 1000)
    ]
    assert [message["left_out"] for message in events] == [1000 - KEPT_MESSAGES, *[0] * (KEPT_MESSAGES - 1)]


async def test_the_stop_goes_first() -> None:
    outgoing = Outgoing()
    outgoing.put_state(lambda: '{"type": "state"}')
    outgoing.put(event(1))
    outgoing.put(AckMessage(id=1, took_ms=1.0))
    outgoing.put(stopping(7, answered=False))
    outgoing.put(stopping(7, answered=True))
    messages = await sent(outgoing)
    assert [message["type"] for message in messages] == ["stop", "ack", "state", "event"]
    assert messages[0]["answered"]
