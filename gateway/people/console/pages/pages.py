"""The open pages, and what one of them may do.

Setpoints are passed on once, as they come, and never repeated: if a page falls silent, the gateway's watchdog stops the
legs. A page's commands carry the time by its own clock, so what was delayed on its way, in a frozen browser or in this
process, is rejected here or by the gateway.
"""

import asyncio
import itertools
import json
import logging
import math
import re
import secrets
import time
from collections import deque
from collections.abc import Awaitable, Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

import segno
from pydantic import ValidationError

from gateway.errors import GatewayError
from gateway.model.staleness import Staleness
from gateway.people.client.lease import RELEASE_S
from gateway.people.console.link import Shared
from gateway.people.console.pages import page_messages as messages
from gateway.people.console.pages.page_calibration import PageCalibration
from gateway.people.console.pages.page_lease import PageLease, StopButton
from gateway.people.console.pages.page_tasks import EndError, Outgoing, PageTasks, Stops, now_ns
from gateway.people.console.pages.page_walk import WISH_SILENT_S, PageCamera, PageWalks
from gateway.people.walking.words import robot_now
from gateway.people.watching.confirmed_stop import Press
from gateway.people.watching.dangers import PowerAlarm, power_now
from gateway.people.watching.live import Receiver, set_upright
from gateway.rate_limit import RateLimit
from schemas import keys
from schemas.ack import Ack
from schemas.config import LimitsReport
from schemas.event import Event
from schemas.gateway_state import GatewayState
from schemas.simulation import BodyReport
from schemas.telemetry import Telemetry
from schemas.words import Kind, Reason

MAX_COMMANDS: Final = 16
"""Most commands of one page that wait for their acknowledgement."""
MAX_STOPS: Final = 32
"""Most kinds of Stops of one page that wait for theirs."""
STOP_LASTS_S: Final = 2.0
"""How long such a Stop is repeated: later, another client may drive that leg."""
PAST_EVENTS: Final = 50
"""Past events that a new page receives."""
GOES_ON_S: Final = 10.0
"""How long after a page's end the next page in its tab continues to drive: a reload is one pull on a phone."""
MAX_NAMES: Final = 50
"""Most names of a page that is reloaded again and again."""
TELEMETRY_HZ: Final = 8.0
TELEMETRY_AT_ONCE: Final = 2
"""So at most 10 messages in any second, while the gateway may publish 100: a phone draws each."""

_WORDS: Final = re.compile(r"[^\s,:]+")

logger = logging.getLogger(__name__)


class Pages(Receiver):
    """All open pages, each of which is sent what the gateway publishes.

    All sessions end when the gateway reports that this console's own certificate is revoked, which it does before it
    closes the connection. A console that is not connected then cannot connect any more, so its pages show no robot;
    its sessions end when it is started with another certificate (`Sessions.begin`).
    """

    def __init__(
        self, common_name: str, end_sessions: Callable[[], int], clock_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        """`common_name` is of this console's own certificate; `end_sessions` writes a file, so a thread calls it."""
        self._clock_ns = clock_ns
        self._common_name = common_name
        self._end_sessions = end_sessions
        self._ending: asyncio.Future[int] | None = None
        self._pages: set[Page] = set()
        self._left: dict[str, tuple[Page, int]] = {}
        """The page of each tab that drove when it was closed, and when that was."""
        self.numbers = itertools.count(1)
        """Page numbers, never used twice: the gateway distinguishes the pages' clocks by them."""
        self._newest: tuple[GatewayState, int] | None = None
        self._alarm = PowerAlarm()
        self._state: Callable[[], str] | None = None
        self._max_age_ms = LimitsReport().max_age_ms
        self._link = messages.link_message("gone")
        self._events: deque[messages.Message] = deque(maxlen=PAST_EVENTS)
        self._telemetry = RateLimit(TELEMETRY_HZ, TELEMETRY_AT_ONCE)

    def __iter__(self) -> Iterator["Page"]:
        return iter(self._pages)

    def __len__(self) -> int:
        return len(self._pages)

    def add(self, page: "Page") -> None:
        """Send it the newest link, events and state, and all later ones."""
        self._pages.add(page)
        for message in (self._link, *self._events):
            page.outgoing.put(message)
        if self._state is not None:
            page.outgoing.put_state(self._state)
        page.allow_age(self._max_age_ms)

    def remove(self, page: "Page", tab: str = "") -> None:
        """Send it nothing more: it is closed. `tab`: the session and its tab; empty: the page named none."""
        self._pages.discard(page)
        if tab and page.drives:
            self._left[tab] = page, self._clock_ns()

    async def sit(self) -> None:
        """Make the robot sit down if a page walks. Return once its legs are stopped."""
        async with asyncio.TaskGroup() as tasks:
            for page in self._pages:
                tasks.create_task(page.sit())

    def former(self, tab: str) -> "Page | None":
        """Return the page that drove in this tab just before; None: none did."""
        since_ns = self._clock_ns() - round(GOES_ON_S * 1e9)
        self._left = {name: left for name, left in self._left.items() if left[1] > since_ns}
        page, _ = self._left.pop(tab, (None, 0))
        return page

    def received_state(self, state: GatewayState, received_ns: int) -> None:
        self._newest = state, received_ns
        self._max_age_ms = state.limits.max_age_ms
        self._alarm.received_state(state, received_ns)
        self._send_state(state, received_ns)

    def _send_state(self, state: GatewayState, received_ns: int) -> None:
        known = {"now": robot_now(state), "whole": state.wire.whole_robot}
        known |= {"power": power_now(state.power), "unconfirmed": self._alarm.sentence}
        self._state = partial(_state_text, state.model_dump_json(), json.dumps(known)[1:-1], received_ns)
        for page in self._pages:
            page.outgoing.put_state(self._state)
            page.allow_age(self._max_age_ms)

    def received_body(self, body: BodyReport) -> None:
        self._send({"type": "body", "body": body})

    def received_telemetry(self, telemetry: Telemetry) -> None:
        if self._telemetry.take(self._clock_ns()):
            self._send({"type": "telemetry", "telemetry": telemetry})

    def received_event(self, event: Event, left_out: int = 0) -> None:
        self._alarm.received_event(event.kind)
        if event.kind == Kind.POWER_UNCONFIRMED and self._newest is not None:
            self._send_state(*self._newest)  # red at once, not with the next state
        self._events.append(messages.event_message(event, left_out))
        self._send(self._events[-1])
        if event.kind == Kind.REVOKED and self._common_name in _WORDS.findall(event.detail):
            logger.warning("this console's certificate (%s) is revoked: all its sessions end", self._common_name)
            self._ending = asyncio.ensure_future(asyncio.to_thread(self._end_sessions))

    def link_changed(self, link: messages.Message) -> None:
        self._link = link
        self._send(link)

    def _send(self, message: messages.Message) -> None:
        for page in self._pages:
            page.outgoing.put(message)


def _state_text(state: str, known: str, received_ns: int) -> str:
    """Return the message. The state's JSON is made once for all pages, its age when it is sent."""
    age_ms = (time.monotonic_ns() - received_ns) / 1e6
    return f'{{"type":"state","age_ms":{age_ms:.1f},{known},"state":{state}}}'


class Page:
    """One page's WebSocket: takes its messages, and answers into `outgoing`. On the event loop."""

    def __init__(self, number: int, role: messages.Role, shared: Shared, former: "Page | None" = None) -> None:
        """`former`: the tab's page before this one, whose lease and walk go on here."""
        person, self._link = shared.person[:40], shared.link
        self.source = f"{person} (page {number})"
        """Its name in states and events."""
        self.names: tuple[str, ...] = (*(() if former is None else former.names), self.source)[-MAX_NAMES:]
        self.outgoing = Outgoing()
        self.camera = PageCamera(shared.stale_ms)
        self.secret = secrets.token_urlsafe()  # names the page in its requests for pictures
        self.picture_request = asyncio.Lock()  # one at a time
        self._role = role
        self._shared = shared
        self._former = former
        self._handed_on = False
        self._calibration = PageCalibration(self._link, partial(self._signed, sent_ms=None), self.outgoing.put)
        if former is None:
            self._lease = PageLease(self._link.client, self.source, self.outgoing.put)
            self._walks = PageWalks(shared, f"{self.source} walks", self.outgoing.put)
        else:
            former._handed_on = True
            self._lease, self._walks = former._lease, former._walks
            self._lease.name = self.source
            self._lease.send = self._walks.send = self.outgoing.put
        self.last_id = self._walks.newest_press
        """The number of the newest press on the page before this one; 0: there was none."""
        self._button = StopButton(self._link.client, f"{person}/page {number}", self.outgoing.put)
        self._max_age_ms = LimitsReport().max_age_ms
        self._staleness = Staleness(self._max_age_ms)
        self._wishes = Staleness(WISH_SILENT_S * 1000)
        """Ages of wishes for the walk: an older wish counts as silence."""
        self._tasks = PageTasks(MAX_COMMANDS, "commands")
        self._leg_stops: dict[tuple[str, str], Stops[dict[str, Any]]] = {}
        """Stops by key and payload."""

    def allow_age(self, max_age_ms: float) -> None:
        """Commands may be as old as the gateway allows (`limits.max_age_ms`; 0: any age)."""
        if max_age_ms != self._max_age_ms:
            self._max_age_ms = max_age_ms
            self._staleness = Staleness(max_age_ms or math.inf)

    def take(self, text: str) -> None:
        """Handle one message of the page. Raises EndError for a message that our pages never send."""
        try:
            message = messages.FROM_PAGE.validate_json(text)
        except ValidationError as error:
            fault = error.errors(include_url=False, include_input=False)[0]
            where = "".join(f"{part}: " for part in (".".join(map(str, fault["loc"])),) if part)
            raise EndError(f"{where}{fault['msg']}") from error
        stops = isinstance(message, messages.StopAllRequest | messages.StopButtonRequest)
        if isinstance(message, messages.AliveMessage):
            self._is_late(message.now_ms)
            self._is_late(message.now_ms, self._wishes)
        elif isinstance(message, messages.CameraMessage):
            self.camera.show(message.shown)
        elif self._role != "operator" and not (self._role == "button" and stops):
            raise EndError("this page only looks" + (", and stops" if self._role == "button" else ""))
        else:
            self._do(message)

    @property
    def drives(self) -> bool:
        """Whether it has the lease."""
        return self._lease.mine

    def go_on(self) -> None:
        """Continue the driving of the page before this one. Nothing moves: all its presses are used up."""
        if self._former is not None:
            self._lease.go_on()

    async def sit(self) -> None:
        """End its walk, if there is one. Return once the legs are stopped."""
        over = asyncio.Event()
        self._walks.when_over(over.set, sits=True)
        await over.wait()

    async def release(self) -> None:
        """Release the lease, also one that the gateway is granting now. Takes `RELEASE_S` at most."""
        self._lease.close()
        await self._lease.tasks.ended(RELEASE_S)

    def close(self) -> None:
        """The WebSocket is closed. A stop that it requested goes on; the lease is released after the walk, unless the
        tab's next page drives on."""
        self._walks.when_over(self._release, sits=False)
        self._shared.stops.leave(self.outgoing)

    def _release(self) -> None:
        if not self._handed_on:
            self._lease.close()

    def _do(self, message: messages.FromPage) -> None:
        match message:
            case messages.StopAllRequest():
                self._shared.stops.press(
                    self.outgoing, message.id, self._button.name if message.button else self.source
                )
            case messages.CommandRequest():
                self._command(message)
            case messages.ResetRequest():
                payload = self._signed({"estop": message.estop}, message.sent_ms, moves=False)
                late = self._is_late(message.sent_ms)
                if late is None:
                    self._ask(message.id, partial(self._link.ask, keys.RESET, payload, again=False))
                else:
                    self._reject(message.id, keys.RESET, late)
            case messages.DriveRequest():
                self._drive(message)
            case messages.WalkWish():
                if self._is_late(message.sent_ms, self._wishes) is None:
                    token = self._lease.token if self._lease.mine else None
                    self._walks.take(message, token, self.camera)
            case messages.PlainRequest(type="upright"):
                self._ask(message.id, lambda: asyncio.to_thread(set_upright, self._link.client()))
            case messages.StopButtonRequest():
                self._button.take(message)
            case messages.PlainRequest():
                self._tasks.check()
                self._tasks.start(self._invite(message.id))
            case messages.CalibrateRequest():
                self._calibration.ask(message, mine=self._lease.mine)

    def _drive(self, message: messages.DriveRequest) -> None:
        self._lease.tasks.check()
        if message.do == "release":  # a robot that walks sits down first
            self._walks.when_over(partial(self._lease.ask, message), sits=True)
        else:
            self._lease.ask(message)

    def _command(self, message: messages.CommandRequest) -> None:
        payload = self._signed(message.payload.model_dump(mode="json", exclude_none=True), message.sent_ms)
        late = self._is_late(message.sent_ms) or self.camera.bars(time.monotonic_ns())
        if message.only_stops:  # accepted at any age, and sent again until it is answered
            self._stop(message, {**payload, "sent_ms": None})
        elif late:
            self._reject(message.id, message.key, late)
        elif self._walks.active:
            if message.id is not None:
                error = "this page walks; sit down first"
                self.outgoing.put(messages.ack_message(message.id, error=error))
        elif message.id is not None:
            self._ask(message.id, partial(self._link.ask, message.key, payload, again=False))
        else:
            with suppress(GatewayError):  # the page receives the link's state
                self._link.client().publish(message.key, payload)  # at most a millisecond

    def _signed(self, payload: dict[str, Any], sent_ms: float | None, *, moves: bool = True) -> dict[str, Any]:
        """A token of an ended lease, which the gateway rejects, stays with what `moves`."""
        token = self._lease.token if moves or self._lease.mine else None
        lease = {} if token is None else {"lease": token}
        return {**payload, **lease, "source": self.source, "sent_ms": sent_ms}

    def _is_late(self, sent_ms: float, among: Staleness | None = None) -> str | None:
        now_ns = time.monotonic_ns()
        return (among or self._staleness).too_old(None, sent_ms, now_ns, now_ns)

    def _reject(self, message_id: int | None, key: str, detail: str) -> None:
        """Reject it as too old: by an answer if the command has an id, otherwise by an event."""
        if message_id is not None:
            ack = Ack(accepted=False, reason=Reason.STALE, detail=detail)
            self.outgoing.put(messages.ack_message(message_id, ack=ack))
            return
        kind, reason = Kind.COMMAND_REJECTED, Reason.STALE
        event = Event(time=datetime.now(UTC), kind=kind, source=self.source, key=key, reason=reason, detail=detail)
        self.outgoing.put(messages.event_message(event))

    def _ask(self, message_id: int, ask: Callable[[], Awaitable[Ack]]) -> None:
        self._tasks.check()
        self._tasks.start(self._answer(message_id, ask))

    async def _answer(self, message_id: int, ask: Callable[[], Awaitable[Ack]]) -> None:
        began_s = time.monotonic()
        ack, error = None, None
        try:
            ack = await ask()
            self._lease.judge(ack)
        except Exception as failed:  # also for want of memory or descriptors: the page has to know
            error = str(failed) or repr(failed)
        took_ms = (time.monotonic() - began_s) * 1000
        self.outgoing.put(messages.ack_message(message_id, took_ms, ack, error))

    async def _invite(self, message_id: int) -> None:
        try:
            url = await asyncio.to_thread(self._shared.new_link)
            code = await asyncio.to_thread(segno.make, url, error="l")
        except GatewayError as error:
            self.outgoing.put({"type": "link_for", "id": message_id, "error": str(error)})
        else:
            rows = ["".join(str(module & 1) for module in row) for row in code.matrix]
            self.outgoing.put({"type": "link_for", "id": message_id, "url": url, "rows": rows})

    def _stop(self, message: messages.CommandRequest, payload: dict[str, Any]) -> None:
        """Request it until it is answered or its time is over. An answer to a newer request also answers older ones."""
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
            self._lease.judge(ack)
        if press.id is not None:
            took_ms = (now_ns() - press.pressed_ns) / 1e6
            self.outgoing.put(messages.ack_message(press.id, took_ms, ack, error))
        if kind in self._leg_stops and not self._leg_stops[kind].unconfirmed:
            del self._leg_stops[kind]
