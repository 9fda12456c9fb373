"""The link of `watch` to the gateway: what fills the model, and an emergency stop that waits for none of it.

Nothing here is called on the thread that reads the keys except `stop` and `reset`, which start a thread and return.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from typing import Final

from gateway.errors import ZenohError
from gateway.people.client.blocking import Client, several_answer
from gateway.people.client.live import CLOSE_S, ERRORS, Live, Receiver
from gateway.people.client.stops import UntilConfirmed
from gateway.people.terminal import visible
from gateway.people.tools.watch.lease_keys import LeaseKeys
from gateway.people.tools.watch.model import Model, Presence
from schemas import keys
from schemas.telemetry import Ack, Event, GatewayState

OTHERS_S: Final = 0.2
"""How long others that answer besides the gateway are waited for."""


class Link(Receiver):
    """`changed` wakes whoever draws."""

    def __init__(
        self,
        connect: Callable[[], Client],
        model: Model,
        lock: threading.Lock,
        changed: Callable[[], None],
        why: Callable[[], list[str]] = list,
    ) -> None:
        """`why` returns a line for each host, why no connection comes about; it may take a second."""
        self._model = model
        self._lock = lock
        self._changed = changed
        # A link that is there has a gateway at its end that is frozen, or nobody behind a router.
        self._live = Live(connect, self, lambda client: [] if client is not None and client.connected else why())
        self._stops = UntilConfirmed(lambda: self._client().estop(), self._stop_answered)
        self._noted = threading.Event()
        """Whether the model knows of the newest press."""
        self.lease = LeaseKeys(lambda: self._live.client, model, lock, changed)

    def start(self) -> None:
        """Begin to connect."""
        self._live.start()

    def close(self) -> None:
        """Let go of the lease, and close the session; gives up after a second where the gateway is frozen."""
        closer = threading.Thread(target=self.lease.close, name="close", daemon=True)
        closer.start()
        closer.join(CLOSE_S)
        self._live.close()

    # ---- keys

    def stop(self) -> None:
        """Request the emergency stop, at once and without waiting, and again until it is confirmed."""
        self._noted.clear()
        self._stops.press()  # first: not even the model's lock stands between the key and the wire
        with self._changes():
            self._model.stop_pressed(time.monotonic_ns())
        self._noted.set()

    def reset(self) -> None:
        """Ask for the reset, once."""
        with self._changes():
            self._model.reset_confirmed(time.monotonic_ns())
            estop = self._model.estop  # the one that the user has seen, not one that somebody requests from now on
        threading.Thread(target=self._reset, args=(estop,), name="reset", daemon=True).start()

    def _stop_answered(self, ack: Ack | None, began_ns: int) -> bool:
        """What came of a request; whether the stop is still wanted."""
        self._noted.wait()
        with self._changes():
            if ack is None:
                self._model.stop_unanswered()
            else:
                self._model.stop_answered(ack, began_ns, time.monotonic_ns())
            wanted = self._model.stop_wanted_ns is not None
        if ack is not None and (client := self._live.client) is not None:
            with suppress(*ERRORS):
                self._note_others(client, keys.ESTOP)
        return wanted

    def _reset(self, estop: int | None) -> None:
        ack = None
        with suppress(*ERRORS):
            ack = self._client().reset(estop)
        with self._changes():
            self._model.reset_answered(ack, time.monotonic_ns())

    def _client(self) -> Client:
        if self._live.client is None:
            raise ZenohError("there is no connection")
        return self._live.client

    # ---- what is received

    def not_opened(self, error: Exception) -> None:
        with self._changes():
            self._model.trouble = self._model.trouble or visible(str(error))

    def received_state(self, state: GatewayState, received_ns: int) -> None:
        with self._lock:
            mode = None if self._model.state is None else self._model.state.mode
            self._model.received_state(state, received_ns, _wall())
        if state.mode != mode:  # else the next picture is soon enough
            self._changed()

    def received_event(self, event: Event, left_out: int = 0) -> None:
        del left_out  # none: the model takes them as they come
        with self._changes():
            self._model.received_event(event, time.monotonic_ns(), _wall())

    def received_token(self, alive: bool) -> None:
        with self._changes():
            self._model.received_token(alive, time.monotonic_ns(), _wall())

    def answered(self, client: Client) -> None:
        self._note_others(client, keys.STATE)

    def looked(self, reasons: list[str]) -> None:
        with self._changes():
            if self._model.presence(time.monotonic_ns()) is not Presence.LIVE:
                self._model.trouble = "\n".join(visible(line) for line in reasons)

    def _note_others(self, client: Client, key: str) -> None:
        count = len(client.answerers(key, OTHERS_S))
        if count > 1:
            with self._changes():
                self._model.note_others(several_answer(count, key), _wall())

    @contextmanager
    def _changes(self) -> Iterator[None]:
        with self._lock:
            yield
        self._changed()


def _wall() -> datetime:
    return datetime.now().astimezone()
