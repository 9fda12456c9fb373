"""A gateway's published reports, validated, and delivered live to a thread or an event loop."""

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partialmethod
from itertools import product
from typing import TYPE_CHECKING, Any, Final

import zenoh
from pydantic import ValidationError

from gateway.errors import GatewayError, UnansweredError
from gateway.people.client.blocking import Client
from gateway.people.client.subscriptions import KEPT_EVENTS, reads, undeclare
from gateway.people.watching.silence import CHECK_EVERY_S, Silence
from schemas import keys
from schemas.ack import Ack
from schemas.event import Event
from schemas.gateway_state import GatewayState
from schemas.simulation import BodyReport
from schemas.telemetry import Telemetry

if TYPE_CHECKING:
    from asyncio import AbstractEventLoop

OPEN_AGAIN_S: Final = 0.3
STATE_ANSWER_S: Final = 0.6
CLOSE_S: Final = 0.5
"""The longest wait for the session to close; with a frozen gateway Zenoh takes ten seconds."""
ERRORS: Final = (GatewayError, zenoh.ZError, ValidationError, RuntimeError)
"""The exceptions of a session and its queries."""


# ---- a simulated body


def is_of_physics(sample: zenoh.Sample, physics: str | None) -> bool:
    """Return whether the process with this Zenoh id published it: without access control, any program may."""
    source = sample.source_info
    return physics is not None and source is not None and str(source.source_id.zid) == physics


def set_upright(client: Client) -> Ack:
    """Put a robot that is simulated with physics on its feet. Raises UnansweredError."""
    try:
        return client.ask(keys.SIM_UPRIGHT, {})
    except UnansweredError as error:
        raise UnansweredError("no simulated body answers: set upright is for `run --sim=physics`") from error


# ---- a connection that stays


class Receiver:
    """Receives reports on threads of `Live`, or on a loop by `OnLoop`. Methods must be fast; here they do nothing."""

    def opened(self) -> None:
        """Called when a session is open. From now on a Stop can be sent."""

    def not_opened(self, error: Exception) -> None:
        """Called when no session could be opened. `Live` tries again."""

    def received_state(self, state: GatewayState, received_ns: int) -> None:
        """Take a state, published or as an answer, received at `received_ns` (monotonic)."""

    def received_event(self, event: Event, left_out: int = 0) -> None:
        """Take an event. `left_out` events before it were dropped."""

    def received_body(self, body: BodyReport) -> None:
        """Take the pose of a robot that is simulated with physics."""

    def received_telemetry(self, telemetry: Telemetry) -> None:
        """Take the robot's measurements."""

    def received_token(self, alive: bool) -> None:
        """Take whether the gateway is `alive`; if not, it or the link has ended (noticed within milliseconds)."""

    def answered(self, client: Client) -> None:
        """Called when the gateway has answered a query for its state."""

    def diagnosed(self, reasons: list[str]) -> None:
        """Take the reasons why no state is received, a line for each host."""


class Live:
    """Opens a session, repeatedly until that succeeds. After a broken link Zenoh itself reconnects to any host.

    Zenoh delivers into rings, which threads of this class empty, so a slow receiver does not delay Zenoh.
    """

    def __init__(
        self, connect: Callable[[], Client], receiver: Receiver, why: Callable[[Client | None], list[str]]
    ) -> None:
        """`why` returns a line for each host that cannot be reached; it may take a second."""
        self.client: Client | None = None
        self._connect = connect
        self._receiver = receiver
        self._why = why
        self._ended = threading.Event()
        self._silence = Silence()
        self._physics: str | None = None
        self._subscribers: list[Any] = []

    def start(self) -> None:
        for loop in (self._open_at_last, self._ask_when_quiet, self._diagnose_when_silent):
            threading.Thread(target=loop, name=f"live {loop.__name__}", daemon=True).start()

    def is_silent(self, now_ns: int) -> bool:
        """Return whether the newest state is so old that the gateway counts as silent."""
        return self._silence.is_long(now_ns)

    def close(self) -> None:
        """Close the session, or give up after `CLOSE_S`."""
        self._ended.set()
        closer = threading.Thread(target=self._close, name="close", daemon=True)
        closer.start()
        closer.join(CLOSE_S)

    def _open_at_last(self) -> None:
        while not self._ended.is_set():
            try:
                self._open()
                return
            except ERRORS as error:
                self._close()  # the link may have broken between the session's opening and a subscription
                self.client = None
                self._silence.not_opened()
                self._receiver.not_opened(error)
            self._ended.wait(OPEN_AGAIN_S)

    def _open(self) -> None:
        client = self._connect()
        self._silence.opened(time.monotonic_ns())
        self.client = client
        receiver, ring = self._receiver, zenoh.handlers.RingChannel
        receiver.opened()
        body = reads(BodyReport.model_validate_json, receiver.received_body)
        # Only the newest state counts, but every event.
        for key, kept, take in (
            (keys.STATE, 2, reads(client.states.join, self._take_state)),
            (keys.EVENT, KEPT_EVENTS, reads(Event.model_validate_json, receiver.received_event)),
            (keys.SIM_BODY, 2, lambda sample: body(sample) if is_of_physics(sample, self._physics) else None),
            (keys.TELEMETRY, 2, reads(Telemetry.model_validate_json, receiver.received_telemetry)),
        ):
            self._read(client.session.declare_subscriber(key, ring(kept)), take)
        alive = client.session.liveliness().declare_subscriber(keys.ALIVE, ring(KEPT_EVENTS), history=True)
        self._read(alive, lambda sample: receiver.received_token(sample.kind == zenoh.SampleKind.PUT))

    def _read(self, subscriber: Any, take: Callable[[zenoh.Sample], None]) -> None:
        """Read a subscriber on a thread, until it is undeclared."""

        def read() -> None:
            with suppress(zenoh.ZError):  # the channel is closed
                for sample in subscriber.handler:
                    take(sample)

        self._subscribers.append(subscriber)
        threading.Thread(target=read, name=f"receive {subscriber.key_expr}", daemon=True).start()

    def _take_state(self, state: GatewayState) -> None:
        received_ns = time.monotonic_ns()
        self._physics = state.physics
        self._silence.received(received_ns)
        self._receiver.received_state(state, received_ns)

    def _ask_when_quiet(self) -> None:
        while not self._ended.wait(CHECK_EVERY_S):
            client = self.client
            if client is not None and self._silence.is_quiet(time.monotonic_ns()):
                with suppress(*ERRORS):
                    state = client.state(STATE_ANSWER_S)
                    self._receiver.received_token(True)
                    self._take_state(state)
                    self._receiver.answered(client)

    def _diagnose_when_silent(self) -> None:
        while not self._ended.wait(CHECK_EVERY_S):
            if self._silence.must_diagnose(time.monotonic_ns()):
                with suppress(*ERRORS):
                    if reasons := self._why(self.client):
                        self._receiver.diagnosed(reasons)
                self._silence.diagnosed(time.monotonic_ns())

    def _close(self) -> None:
        with suppress(*ERRORS):
            undeclare(self._subscribers)
        with suppress(*ERRORS):
            if self.client is not None:
                self.client.close()


# ---- to an event loop


class OnLoop(Receiver):
    """Calls receivers on an event loop, in order: the newest of each kind, and at most 256 events, so that a flood
    takes no memory."""

    def __init__(self, loop: "AbstractEventLoop", *receivers: Receiver) -> None:
        self._loop = loop
        self._receivers = receivers
        self._lock = threading.Lock()
        self._waiting: dict[str, tuple[object, ...]] = {}
        self._events: deque[Event] = deque(maxlen=KEPT_EVENTS)
        self._left_out = 0

    def received_event(self, event: Event, left_out: int = 0) -> None:
        with self._lock:
            self._left_out += left_out + (len(self._events) == KEPT_EVENTS)
            self._events.append(event)
        self._put("received_event")

    def _put(self, name: str, *arguments: object) -> None:
        """Call the receivers' method of this name on the loop, after the waiting calls."""
        with self._lock:
            announced = bool(self._waiting)
            self._waiting.pop(name, None)
            self._waiting[name] = arguments
        if not announced:
            with suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._deliver)

    opened: Any = partialmethod(_put, "opened")
    not_opened: Any = partialmethod(_put, "not_opened")
    diagnosed: Any = partialmethod(_put, "diagnosed")
    answered: Any = partialmethod(_put, "answered")
    received_state: Any = partialmethod(_put, "received_state")
    received_body: Any = partialmethod(_put, "received_body")
    received_telemetry: Any = partialmethod(_put, "received_telemetry")
    received_token: Any = partialmethod(_put, "received_token")

    def _deliver(self) -> None:
        with self._lock:
            waiting, self._waiting = self._waiting, {}
            events, left_out = list(self._events), self._left_out
            self._events.clear()
            self._left_out = 0
        for name, arguments in waiting.items():
            calls = [arguments]
            if name == "received_event":
                calls = [(each, 0 if number else left_out) for number, each in enumerate(events)]
            for receiver, call in product(self._receivers, calls):
                getattr(receiver, name)(*call)
