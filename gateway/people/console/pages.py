"""The pages that are open, and what one of them may do.

Setpoints go through as they come, once. Nothing here repeats one: where a page falls silent, the gateway's watchdog
stops the legs. A page's commands carry the time by its own clock, so that what waited on the way, in a frozen browser
or in this process, is rejected here or by the gateway.
"""

import asyncio
import json
import logging
import math
import re
import time
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

import segno
from pydantic import ValidationError

from gateway.errors import GatewayError
from gateway.geometry import Geometry
from gateway.model.staleness import Staleness
from gateway.people.client.confirmed_stop import Press
from gateway.people.console.driving import Driving
from gateway.people.console.link import GatewayLink, Listener
from gateway.people.console.messages import (
    FROM_PAGE,
    AckMessage,
    Alive,
    BodyMessage,
    Calibrate,
    Command,
    EventMessage,
    Lease,
    LinkFor,
    LinkForMessage,
    LinkMessage,
    Reset,
    Role,
    StopAll,
    StopButton,
    Upright,
    WalkWish,
)
from gateway.people.console.outgoing import Outgoing
from gateway.people.console.page_calibration import Calibrating
from gateway.people.console.page_walk import Walking
from gateway.people.console.pressing import Pressing
from gateway.people.console.stops import Stops, now_ns
from gateway.people.walking import robot_now
from schemas import keys
from schemas.telemetry import Ack, BodyReport, Event, GatewayState, Kind, LimitsReport, Reason

WISH_AGE_MS: Final = 250.0
"""Of a wish for the walk: what comes later counts as silence (`walking.SILENT_S`)."""
MAX_QUESTIONS: Final = 16
"""Of one page, under way at once."""
MAX_STOPS: Final = 32
"""Kinds of Stops of legs and servos, of one page, under way at once."""
STOP_LASTS_S: Final = 2.0
"""For so long one of these is asked for again: later, somebody else may drive that leg."""
KEPT_EVENTS: Final = 50
"""What a page that opens gets of the past."""


_WORDS: Final = re.compile(r"[^\s,:]+")

logger = logging.getLogger(__name__)


class EndError(Exception):
    """Ends a page's WebSocket; the text is the reason."""


class Pages(Listener):
    """All open pages; what the gateway publishes goes to each of them.

    All sessions end when the gateway says that this console's own certificate is revoked. It says so before it lets go
    of the connection. A console that is not connected then gets in no more, so its pages show no robot, and its
    sessions end when it is started with another certificate (`Register.begin`).
    """

    def __init__(self, common_name: str, end_sessions: Callable[[], int]) -> None:
        """`common_name` is of this console's own certificate; `end_sessions` writes a file, so a thread calls it."""
        self._common_name = common_name
        self._end_sessions = end_sessions
        self._ending: asyncio.Future[int] | None = None
        self._pages: set[Page] = set()
        self._opened = 0
        self._state: Callable[[], str] | None = None
        self._max_age_ms = LimitsReport().max_age_ms
        self._link = LinkMessage(status="gone")
        self._events: deque[EventMessage] = deque(maxlen=KEPT_EVENTS)

    def __len__(self) -> int:
        return len(self._pages)

    def add(self, page: "Page") -> None:
        """It receives everything from now on, beginning with what is known."""
        self._pages.add(page)
        page.outgoing.put(self._link)
        for event in self._events:
            page.outgoing.put(event)
        if self._state is not None:
            page.outgoing.put_state(self._state)
        page.allow_age(self._max_age_ms)

    def remove(self, page: "Page") -> None:
        """It is closed."""
        self._pages.discard(page)

    def next_number(self) -> int:
        """Of a page: no two have the same, so that the gateway takes no page's clock for another's."""
        self._opened += 1
        return self._opened

    def received_state(self, state: GatewayState, received_ns: int) -> None:
        self._state = partial(_state_text, state.model_dump_json(), json.dumps(robot_now(state)), received_ns)
        self._max_age_ms = state.limits.max_age_ms
        for page in self._pages:
            page.outgoing.put_state(self._state)
            page.allow_age(self._max_age_ms)

    def received_body(self, body: BodyReport) -> None:
        for page in self._pages:
            page.outgoing.put(BodyMessage(body=body))

    def received_event(self, event: Event, left_out: int = 0) -> None:
        self._events.append(EventMessage(event=event, left_out=left_out))
        self._send(self._events[-1])
        if event.kind == Kind.REVOKED and self._common_name in _WORDS.findall(event.detail):
            logger.warning("this console's certificate (%s) is revoked: all its sessions end", self._common_name)
            self._ending = asyncio.ensure_future(asyncio.to_thread(self._end_sessions))

    def link_changed(self, link: LinkMessage) -> None:
        self._link = link
        self._send(link)

    def _send(self, message: EventMessage | LinkMessage) -> None:
        for page in self._pages:
            page.outgoing.put(message)


def _state_text(state: str, now: str, received_ns: int) -> str:
    """A StateMessage: the JSON of the state and of its sentence is made once for all pages, its age when it is sent."""
    age_ms = (time.monotonic_ns() - received_ns) / 1e6
    return f'{{"type":"state","age_ms":{age_ms:.1f},"now":{now},"state":{state}}}'


class Page:
    """One page's WebSocket: takes its messages, and answers into `outgoing`."""

    def __init__(
        self,
        number: int,
        person: str,
        role: Role,
        link: GatewayLink,
        stops: Stops[str | None],
        geometry: Geometry,
        new_link: Callable[[], str],
    ) -> None:
        self.source = f"{person[:40]} (page {number})"
        self.outgoing = Outgoing()
        self._role = role
        self._link = link
        self._stops = stops
        self._driving = Driving(link.client, self.source, self.outgoing.put)
        self._calibrating = Calibrating(link, partial(self._signed, sent_ms=None), self.outgoing.put)
        self._walking = Walking(link.connect, f"{self.source} walks", geometry, self.outgoing.put)
        self._new_link = new_link
        self._button = Pressing(link.client, f"{person[:40]}/page {number}", self.outgoing.put)
        self._max_age_ms = LimitsReport().max_age_ms
        self._staleness = Staleness(self._max_age_ms)
        self._wishes = Staleness(WISH_AGE_MS)
        self._questions: set[asyncio.Task[None]] = set()
        self._leg_stops: dict[tuple[str, str], Stops[dict[str, Any]]] = {}
        """By their key and what they stop."""

    def allow_age(self, max_age_ms: float) -> None:
        """Commands may be as old as the gateway lets them (`limits.max_age_ms`, 0: any age).

        The gateway cannot know how long a page's first command took; here the page's pings show its clock.
        """
        if max_age_ms != self._max_age_ms:
            self._max_age_ms = max_age_ms
            self._staleness = Staleness(max_age_ms or math.inf)

    def take(self, text: str) -> None:
        """One message of the page's. Raises EndError for what no page of ours sends."""
        try:
            message = FROM_PAGE.validate_json(text)
        except ValidationError as error:
            raise EndError(_first_fault(error)) from error
        if isinstance(message, Alive):
            self._is_late(message.now_ms)
            self._is_late(message.now_ms, self._wishes)
        elif self._role != "operator" and not (self._role == "button" and isinstance(message, StopAll | StopButton)):
            raise EndError("this page only looks" + (", and stops" if self._role == "button" else ""))
        else:
            self._do(message)

    def close(self) -> None:
        """The WebSocket is closed. A stop that it asked for goes on; the lease is given back, after the walk."""
        self._walking.when_over(self._driving.close, sits=False)
        self._stops.leave(self.outgoing)

    def _do(
        self, message: Command | StopAll | Reset | Lease | Calibrate | WalkWish | StopButton | LinkFor | Upright
    ) -> None:
        match message:
            case StopAll():
                self._stops.press(self.outgoing, message.id, self._button.name if message.button else None)
            case Command():
                self._command(message)
            case Reset():
                late = self._is_late(message.sent_ms)
                if late is None:
                    self._ask(message.id, keys.RESET, self._signed({"estop": message.estop}, message.sent_ms))
                else:
                    self._reject(message.id, keys.RESET, late)
            case Lease():
                self._lease(message)
            case WalkWish():
                self._wish(message)
            case Upright():
                self._begin(message.id, self._link.set_upright)
            case StopButton():
                self._button.take(message)
            case LinkFor():
                self._start(self._invite(message.id))
            case Calibrate():
                if self._calibrating.is_full:
                    raise EndError("too many steps of the calibration wait for their answers")
                self._calibrating.ask(message, mine=self._driving.mine)

    def _wish(self, message: WalkWish) -> None:
        if self._is_late(message.sent_ms, self._wishes) is None:
            self._walking.take(message, self._driving.token if self._driving.mine else None)

    def _lease(self, message: Lease) -> None:
        if self._driving.is_full:
            raise EndError("too many requests for the lease wait for their answers")
        if message.do == "release":  # who walks sits down first
            self._walking.when_over(partial(self._driving.ask, message), sits=True)
        else:
            self._driving.ask(message)

    def _command(self, message: Command) -> None:
        payload = self._signed(message.payload.model_dump(mode="json", exclude_none=True), message.sent_ms)
        late = self._is_late(message.sent_ms)
        if message.only_stops:  # however old; and sent again until it is answered
            self._stop(message, {**payload, "sent_ms": None})
        elif late is not None:
            self._reject(message.id, message.key, late)
        elif self._walking.active:
            if message.id is not None:
                self.outgoing.put(AckMessage(id=message.id, took_ms=0.0, error="this page walks; sit down first"))
        elif message.id is not None:
            self._ask(message.id, message.key, payload)
        else:
            with suppress(GatewayError):  # the page is sent the link's state
                self._link.client().publish(message.key, payload)  # at most a millisecond

    def _signed(self, payload: dict[str, Any], sent_ms: float | None) -> dict[str, Any]:
        token = self._driving.token
        lease = {} if token is None else {"lease": token}
        return {**payload, **lease, "source": self.source, "sent_ms": sent_ms}

    def _is_late(self, sent_ms: float, among: Staleness | None = None) -> str | None:
        now_ns = time.monotonic_ns()
        return (among or self._staleness).too_old(None, sent_ms, now_ns, now_ns)

    def _reject(self, message_id: int | None, key: str, detail: str) -> None:
        if message_id is not None:
            ack = Ack(accepted=False, reason=Reason.STALE, detail=detail)
            self.outgoing.put(AckMessage(id=message_id, took_ms=0.0, ack=ack))
        else:
            self.outgoing.put(EventMessage(event=_rejection(self.source, key, detail)))

    def _ask(self, message_id: int | None, key: str, payload: dict[str, Any]) -> None:
        self._begin(message_id, partial(self._link.ask, key, payload, again=False))

    def _begin(self, message_id: int | None, ask: Callable[[], Awaitable[Ack]]) -> None:
        self._start(self._answer(message_id, ask))

    def _start(self, answer: Coroutine[Any, Any, None]) -> None:
        if len(self._questions) >= MAX_QUESTIONS:
            answer.close()
            raise EndError(f"{MAX_QUESTIONS} commands of this page wait for their acknowledgement")
        question = asyncio.create_task(answer)
        self._questions.add(question)
        question.add_done_callback(self._questions.discard)

    async def _invite(self, message_id: int) -> None:
        try:
            url = await asyncio.to_thread(self._new_link)  # which writes a file
            code = await asyncio.to_thread(segno.make, url, error="l")
        except GatewayError as error:
            self.outgoing.put(LinkForMessage(id=message_id, error=str(error)))
        else:
            rows = ["".join(str(module & 1) for module in row) for row in code.matrix]
            self.outgoing.put(LinkForMessage(id=message_id, url=url, rows=rows))

    def _stop(self, message: Command, payload: dict[str, Any]) -> None:
        """Ask until it is answered or its time is over; the answer to a newer one is also that of an older one."""
        kind = (message.key, message.payload.model_dump_json())
        if kind not in self._leg_stops:
            if len(self._leg_stops) >= MAX_STOPS:
                raise EndError(f"{MAX_STOPS} Stops of this page wait for their acknowledgement")
            ask = partial(self._link.ask, message.key, again=True)
            self._leg_stops[kind] = Stops(ask, partial(self._stop_noted, kind), STOP_LASTS_S)
        self._leg_stops[kind].press(self.outgoing, message.id, payload)

    def _stop_noted(
        self, kind: tuple[str, str], press: Press[Outgoing, dict[str, Any]], ack: Ack | None, error: str | None
    ) -> None:
        if not press.over:
            return
        if ack is not None:
            self._driving.judge(ack)
        if press.id is not None:
            took_ms = (now_ns() - press.pressed_ns) / 1e6
            self.outgoing.put(AckMessage(id=press.id, took_ms=took_ms, ack=ack, error=error))
        if kind in self._leg_stops and not self._leg_stops[kind].unconfirmed:
            del self._leg_stops[kind]

    async def _answer(self, message_id: int | None, ask: Callable[[], Awaitable[Ack]]) -> None:
        began_s = time.monotonic()
        ack, error = None, None
        try:
            ack = await ask()
            self._driving.judge(ack)
        except Exception as failed:  # also without memory or descriptors: the page has to know
            error = str(failed) or repr(failed)
        if message_id is not None:
            took_ms = (time.monotonic() - began_s) * 1000
            self.outgoing.put(AckMessage(id=message_id, took_ms=took_ms, ack=ack, error=error))


def _rejection(source: str, key: str, detail: str) -> Event:
    return Event(
        time=datetime.now(UTC),
        kind=Kind.COMMAND_REJECTED,
        source=source,
        key=key,
        reason=Reason.STALE,
        detail=detail,
    )


def _first_fault(error: ValidationError) -> str:
    fault = error.errors(include_url=False, include_input=False)[0]
    where = ".".join(str(part) for part in fault["loc"])
    return f"{where}: {fault['msg']}" if where else fault["msg"]
