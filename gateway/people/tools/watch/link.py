"""The link of `watch` to the gateway: threads that fill the model, and an emergency stop that waits for none of them.

Nothing here is called on the thread that reads the keys except `stop` and `reset`, which start a thread and return.
"""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from typing import Any, Final

import zenoh
from pydantic import BaseModel, ValidationError

from gateway.errors import GatewayError
from gateway.people.client.blocking import Client, several_answer
from gateway.people.tools.terminal import visible
from gateway.people.tools.watch.lease_keys import LeaseKeys
from gateway.people.tools.watch.model import Model, Presence
from schemas import keys
from schemas.telemetry import Ack, Event, GatewayState

POLL_S: Final = 0.4
"""How often a gateway that publishes no state (`telemetry.state_hz = 0`) is asked for it."""
ASK_AFTER_MS: Final = 300.0
ANSWER_S: Final = 0.6
LOOK_EVERY_S: Final = 3.0
"""How often it is looked why there is no connection: each look is a connection, which costs the robot something."""
OTHERS_S: Final = 0.2
"""How long others that answer besides the gateway are listened for."""
STOPS_AT_ONCE: Final = 4
"""Requests under way at most; a key that is held down repeats some 30 times a second."""
CLOSE_S: Final = 0.5
"""How long to wait for the session to close; with a frozen gateway Zenoh would take ten seconds."""

_MANY: Final = 256
_ERRORS: Final = (GatewayError, zenoh.ZError, ValidationError, RuntimeError)


class Link:
    """Opens a session, trying until it succeeds; after a broken link Zenoh itself reconnects to any of the hosts.

    `changed` wakes whoever draws.
    """

    def __init__(
        self,
        connect: Callable[[], Client],
        model: Model,
        lock: threading.Lock,
        changed: Callable[[], None],
        why: Callable[[], list[str]] = list,
    ) -> None:
        """`why` says, a line for each host, why no connection comes about; it may take a second."""
        self._connect = connect
        self._model = model
        self._lock = lock
        self._changed = changed
        self._why = why
        self._next_look_s = 0.0
        self._looks = threading.Semaphore(1)
        self._client: Client | None = None
        self._subscribers: list[Any] = []
        self._ended = threading.Event()
        self._stops = threading.Semaphore(STOPS_AT_ONCE)
        self._thread = threading.Thread(target=self._run, name="link", daemon=True)
        self.lease = LeaseKeys(lambda: self._client, model, lock, changed)

    def start(self) -> None:
        """Begin to connect."""
        self._thread.start()

    def close(self) -> None:
        """Close the session, or give up after `CLOSE_S`."""
        self._ended.set()
        closer = threading.Thread(target=self._close, name="close", daemon=True)
        closer.start()
        closer.join(CLOSE_S)

    # ---- keys

    def stop(self) -> None:
        """Request the emergency stop, at once and without waiting, and again until it is confirmed."""
        noted = threading.Event()
        self._try_stop(noted)  # first: not even the model's lock stands between the key and the wire
        with self._lock:
            self._model.stop_pressed(time.monotonic_ns())
        noted.set()
        self._changed()

    def reset(self) -> None:
        """Ask for the reset, once."""
        with self._lock:
            self._model.reset_confirmed(time.monotonic_ns())
            estop = self._model.estop  # the one that the user has seen, not one that somebody requests from now on
        self._changed()
        threading.Thread(target=self._reset, args=(estop,), name="reset", daemon=True).start()

    def _try_stop(self, noted: threading.Event | None = None) -> None:
        if self._stops.acquire(blocking=False):
            threading.Thread(target=self._stop, args=(noted,), name="stop", daemon=True).start()

    def _stop(self, noted: threading.Event | None) -> None:
        began_ns = time.monotonic_ns()
        ack = self._ask(lambda client: client.estop())
        self._stops.release()
        if noted is not None:
            noted.wait()
        with self._lock:
            if ack is None:
                self._model.stop_unanswered()
            else:
                self._model.stop_answered(ack, began_ns, time.monotonic_ns())
        self._changed()
        if ack is not None and self._client is not None:
            self._note_others(self._client, keys.ESTOP)

    def _reset(self, estop: int | None) -> None:
        ack = self._ask(lambda client: client.reset(estop))
        with self._lock:
            self._model.reset_answered(ack, time.monotonic_ns())
        self._changed()

    def _ask(self, ask: Callable[[Client], Ack]) -> Ack | None:
        client = self._client
        if client is None:
            return None
        with suppress(*_ERRORS):
            return ask(client)
        return None

    # ---- what is heard

    def _run(self) -> None:
        while not self._ended.is_set() and self._client is None:
            self._open()
            self._ended.wait(POLL_S if self._client is None else 0)
        while not self._ended.wait(POLL_S):
            with self._lock:
                quiet = self._model.state_age_ms(time.monotonic_ns()) > ASK_AFTER_MS
                silent = self._model.presence(time.monotonic_ns()) is Presence.SILENT
                stop_wanted = self._model.stop_wanted_ns is not None
            if stop_wanted:
                self._try_stop()
            if quiet:
                self._ask_for_state()
            if silent:
                self._look_why()

    def _open(self) -> None:
        try:
            client = self._connect()
            # Before it subscribes: from here on a stop can be sent.
            self._client = client
            self._subscribe(client.session)
        except _ERRORS as error:
            self._client = None
            with self._lock:
                if not self._model.trouble:
                    self._model.trouble = visible(str(error))
                if self._model.stop_wanted_ns is not None:
                    self._model.stop_unanswered()
            self._changed()
            self._look_why()
            return
        with self._lock:
            stop_wanted = self._model.stop_wanted_ns is not None
        if stop_wanted:
            self._try_stop()
        self._ask_for_state()

    def _look_why(self) -> None:
        """Find out which step of the way fails, on a thread of its own: nothing waits for that, least of all a Stop."""
        if time.monotonic() >= self._next_look_s and self._looks.acquire(blocking=False):
            self._next_look_s = time.monotonic() + LOOK_EVERY_S
            threading.Thread(target=self._look, name="look why", daemon=True).start()

    def _look(self) -> None:
        with suppress(*_ERRORS):
            client = self._client
            # A link that is there has a gateway at its end that is frozen, or nobody behind a router.
            linked = client is not None and bool(client.session.info.links())
            found = [] if linked else self._why()
            with self._lock:
                if found and self._model.presence(time.monotonic_ns()) is not Presence.LIVE:
                    self._model.trouble = "\n".join(visible(line) for line in found)
            self._changed()
        self._looks.release()

    def _subscribe(self, session: zenoh.Session) -> None:
        for key, kind in ((keys.STATE, GatewayState), (keys.EVENT, Event)):
            self._listen(session.declare_subscriber(key, zenoh.handlers.RingChannel(_MANY)), self._report_of(kind))
        alive = session.liveliness().declare_subscriber(keys.ALIVE, zenoh.handlers.RingChannel(_MANY), history=True)
        self._listen(alive, self._token)

    def _listen(self, subscriber: Any, take: Callable[[zenoh.Sample], None]) -> None:
        """Read a subscriber on a thread of its own, until it is undeclared."""
        handler = subscriber.handler

        def read() -> None:
            with suppress(zenoh.ZError):  # the channel is closed
                for sample in handler:
                    take(sample)

        self._subscribers.append(subscriber)
        threading.Thread(target=read, name=f"listen to {subscriber.key_expr}", daemon=True).start()

    def _report_of(self, kind: type[BaseModel]) -> Callable[[zenoh.Sample], None]:
        def take(sample: zenoh.Sample) -> None:
            with suppress(ValidationError):
                self._heard(kind.model_validate_json(sample.payload.to_bytes()))

        return take

    def _heard(self, report: BaseModel) -> None:
        now_ns, wall = time.monotonic_ns(), datetime.now().astimezone()
        with self._lock:
            mode = None if self._model.state is None else self._model.state.mode
            if isinstance(report, GatewayState):
                self._model.heard_state(report, now_ns, wall)
                if report.mode == mode:
                    return  # the next picture is soon enough
            elif isinstance(report, Event):
                self._model.heard_event(report, now_ns, wall)
        self._changed()

    def _token(self, sample: zenoh.Sample) -> None:
        alive = sample.kind == zenoh.SampleKind.PUT
        with self._lock:
            self._model.heard_token(alive, time.monotonic_ns(), datetime.now().astimezone())
        self._changed()

    def _ask_for_state(self) -> None:
        client = self._client
        if client is None:
            return
        with suppress(*_ERRORS):
            self._heard(client.state(ANSWER_S))
            self._note_others(client, keys.STATE)

    def _note_others(self, client: Client, key: str) -> None:
        count = len(client.answerers(key, OTHERS_S))
        if count > 1:
            with self._lock:
                self._model.heard_others(several_answer(count, key), datetime.now().astimezone())
            self._changed()

    def _close(self) -> None:
        with suppress(*_ERRORS):
            self.lease.close()
            for subscriber in self._subscribers:
                subscriber.undeclare()
            if self._client is not None:
                self._client.close()
