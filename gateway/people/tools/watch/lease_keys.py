"""The keys of `watch` about the lease: ask, take, let go. Each on a thread: no key waits for an answer."""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Final

import zenoh

from gateway.errors import GatewayError, LeaseLostError, RejectedError
from gateway.people.client.blocking import Client
from gateway.people.tools import kept_lease
from gateway.people.tools.watch.model import Model, Tone

_ERRORS: Final = (GatewayError, zenoh.ZError, RuntimeError)


class LeaseKeys:
    """While `watch` holds the lease, `send` of the same user drives under it."""

    def __init__(
        self, client: Callable[[], Client | None], model: Model, lock: threading.Lock, changed: Callable[[], None]
    ) -> None:
        """As `Link`, which makes it."""
        self._client = client
        self._model = model
        self._lock = lock
        self._changed = changed
        self._held = ExitStack()

    def ask(self) -> None:
        """Tell the holder that we would like to drive."""
        with self._lock:
            holder = self._model.holder
        self._begin(self._ask, holder)

    def take(self) -> None:
        """Take it, once somebody has said yes; by force where somebody else drives."""
        with self._lock:
            self._model.take_confirmed(time.monotonic_ns())
            holder = self._model.holder
        self._begin(self._take, holder)

    def release(self) -> None:
        """Let go of it."""
        self._begin(self._release, None)

    def close(self) -> None:
        """Let go of what is held."""
        self._held.close()

    def _begin(self, do: Callable[[Client, str | None], str], holder: str | None) -> None:
        threading.Thread(target=self._run, args=(do, holder), name="lease", daemon=True).start()

    def _run(self, do: Callable[[Client, str | None], str], holder: str | None) -> None:
        tone, text = Tone.BAD, "NOT DONE: there is no connection"
        client = self._client()
        try:
            if client is not None:
                tone, text = Tone.GOOD, do(client, holder)
        except RejectedError as error:
            text = f"NOT DONE: {error.reason}: {error.detail}"
        except _ERRORS:
            text = "NOT DONE: nobody answered (an observer's certificate may not drive)"
        self._note(tone, text)

    def _ask(self, client: Client, holder: str | None) -> str:
        if holder is None:
            return "nobody drives, so there is nobody to ask"
        ack = client.ask_for_lease(kept_lease.me())
        if not ack.accepted:
            raise RejectedError(ack.reason or "", ack.detail or "")
        return f"{holder} is asked, and may hand over"

    def _take(self, client: Client, holder: str | None) -> str:
        with ExitStack() as held:
            held.callback(self._drives, False)
            lease = held.enter_context(kept_lease.acquired(client, take=holder is not None, on_lost=self._lost))
            self._held = held.pop_all()
        self._drives(True)
        return f"{lease.holder} drives: `send` of this user counts, until t is pressed again"

    def _release(self, _client: Client, _holder: str | None) -> str:
        self._held.close()
        return "released: commands are taken from anyone again"

    def _lost(self, error: LeaseLostError) -> None:
        self._held.close()
        self._note(Tone.BAD, f"LOST: {error.detail}")

    def _note(self, tone: Tone, text: str) -> None:
        with self._lock:
            self._model.lease_answered(tone, text, time.monotonic_ns())
        self._changed()

    def _drives(self, drives: bool) -> None:
        with self._lock:
            self._model.drives = drives
