"""The terminal of `watch`. No key waits: a reset and the lease are requested on threads of their own."""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from datetime import datetime
from functools import partial
from typing import Final

from rich.text import Text

from gateway.errors import LeaseLostError, RejectedError, ZenohError
from gateway.people.client.blocking import Client, several_answer
from gateway.people.client.live import CLOSE_S, ERRORS, Live, Receiver
from gateway.people.terminal.screen import Screen
from gateway.people.terminal.stop_status import Tone
from gateway.people.tools import kept_lease
from gateway.people.tools.watch.model import Confirmation, Model, WatchedPresence
from gateway.people.tools.watch.view import picture
from gateway.text import visible
from schemas import keys as wire
from schemas.lease import LeaseAck
from schemas.telemetry import Ack, Event, GatewayState, Telemetry

_OTHERS_S: Final = 0.2
"""How long to wait for replies of other programs than the gateway."""
_NO_KEYS: Final = frozenset({"escape", "up", "down", "left", "right"})


class WatchScreen(Screen, Receiver):
    """Shown until q. While it holds the lease, `send` of the same user drives under it."""

    def __init__(
        self,
        connect: Callable[[], Client],
        where: str,
        why: Callable[[], list[str]] = list,
        own_expiry: str | None = None,
    ) -> None:
        """`why` returns a line for each host: why connecting fails. It may take a second."""
        super().__init__(lambda: self._client().estop())
        self.model = Model(own_expiry=own_expiry, stop=self.stop)
        self._where = where
        # With a link, the gateway at its end is frozen, or none is behind the router.
        self._link = Live(connect, self, lambda client: [] if client is not None and client.connected else why())
        self._lease = ExitStack()

    def begin(self) -> None:
        self._link.start()

    def end(self) -> None:
        """Release the lease and close the session; gives up after a second where the gateway is frozen.

        The robot goes on: nothing here moves it.
        """
        closer = threading.Thread(target=self._lease.close, name="close", daemon=True)
        closer.start()
        closer.join(CLOSE_S)
        self._link.close()

    # ---- keys

    def press(self, key: str) -> bool:
        if key in ("q", "Q"):
            return False
        if key not in _NO_KEYS:
            self._press(key.lower())
        return True

    def _press(self, key: str) -> None:
        now_ns = time.monotonic_ns()
        with self.lock:
            model = self.model
            asking, holder = model.asking(now_ns), model.holder
            estop = model.stop.estop  # the one that the user has seen, not one that somebody requests from now on
            match asking, key:
                case Confirmation.RESET, "y":
                    self.take_stop_back()
                    model.reset_confirmed(now_ns)
                    self._begin(partial(self._reset, estop=estop), "NO RESET", "reset")
                case Confirmation.TAKE, "y":
                    model.take_confirmed(now_ns)
                    self._begin(partial(self._take, holder=holder))
                case Confirmation(), _:
                    model.declined(now_ns)
                case None, "r":
                    model.ask(Confirmation.RESET, now_ns)
                case None, "t" if model.drives:
                    self._begin(self._release)
                case None, "t":
                    model.ask(Confirmation.TAKE, now_ns)
                case None, "a":
                    self._begin(partial(self._ask, holder=holder))

    def _begin(self, do: Callable[[Client], str], failed: str = "NOT DONE", may_not: str = "drive") -> None:
        """Request it on a thread, and show the result."""

        def run() -> None:
            tone, text = Tone.BAD, f"{failed}: there is no connection"
            try:
                if self._link.client is not None:
                    tone, text = Tone.GOOD, do(self._link.client)
            except RejectedError as error:
                text = f"{failed}: {error.reason}: {error.detail}"
            except ERRORS:
                text = f"{failed}: nobody answered (an observer's certificate may not {may_not})"
            self._remark(tone, text)

        threading.Thread(target=run, name="key", daemon=True).start()

    def _remark(self, tone: Tone, text: str) -> None:
        with self.changes():
            self.model.answered(tone, text, time.monotonic_ns())

    # ---- the emergency stop

    def request_stop(self) -> None:
        super().request_stop()
        with self.changes():
            self.model.stop_pressed()

    def stop_answered(self, outcome: Ack | Exception) -> bool:
        wanted = super().stop_answered(outcome)
        if isinstance(outcome, Ack):
            with suppress(RuntimeError):  # the system allows no more threads
                threading.Thread(target=self._who_answered, name="others", daemon=True).start()
        return wanted

    def _who_answered(self) -> None:
        if (client := self._link.client) is not None:
            with suppress(*ERRORS):
                self._note_others(client, wire.ESTOP)

    def _client(self) -> Client:
        if self._link.client is None:
            raise ZenohError("there is no connection")
        return self._link.client

    # ---- the reset and the lease: each returns the sentence for its success

    def _reset(self, client: Client, estop: int | None) -> str:
        _check_accepted(client.reset(estop))
        return "reset; nothing moves until it is started again"

    def _ask(self, client: Client, holder: str | None) -> str:
        """Ask the holder for the lease."""
        if holder is None:
            return "nobody drives, so there is nobody to ask"
        _check_accepted(client.ask_for_lease(kept_lease.me()))
        return f"{holder} is asked, and may hand over"

    def _take(self, client: Client, holder: str | None) -> str:
        """Take it, by force where somebody else drives."""
        with ExitStack() as held:
            held.callback(self._drives, False)
            lease = held.enter_context(kept_lease.acquired(client, take=holder is not None, on_lost=self._lost))
            self._lease = held.pop_all()
        self._drives(True)
        return f"{lease.holder} drives: `send` of this user counts, until t is pressed again"

    def _release(self, _client: Client) -> str:
        self._lease.close()
        return "released: commands are taken from anyone again"

    def _lost(self, error: LeaseLostError) -> None:
        self._lease.close()
        self._remark(Tone.BAD, f"LOST: {error.detail}")

    def _drives(self, drives: bool) -> None:
        with self.lock:
            self.model.drives = drives

    # ---- received

    def not_opened(self, error: Exception) -> None:
        with self.changes():
            self.model.trouble = self.model.trouble or visible(str(error))

    def received_state(self, state: GatewayState, received_ns: int) -> None:
        with self.lock:
            mode = None if self.model.state is None else self.model.state.mode
            self.model.received_state(state, received_ns, _wall())
        if state.mode != mode:  # else the next picture is soon enough
            self.changed.set()

    def received_event(self, event: Event, left_out: int = 0) -> None:
        del left_out  # none: the model takes them as they come
        with self.changes():
            self.model.received_event(event, time.monotonic_ns(), _wall())

    def received_telemetry(self, telemetry: Telemetry) -> None:
        with self.lock:
            self.model.received_telemetry(telemetry, time.monotonic_ns())

    def received_token(self, alive: bool) -> None:
        with self.changes():
            self.model.received_token(alive, time.monotonic_ns(), _wall())

    def answered(self, client: Client) -> None:
        self._note_others(client, wire.STATE)

    def looked(self, reasons: list[str]) -> None:
        with self.changes():
            if self.model.presence(time.monotonic_ns()) is not WatchedPresence.LIVE:
                self.model.trouble = "\n".join(visible(line) for line in reasons)

    def _note_others(self, client: Client, key: str) -> None:
        count = len(client.answerers(key, _OTHERS_S))
        if count > 1:
            with self.changes():
                self.model.note_others(several_answer(count, key), _wall())

    # ---- drawing

    def picture(self, columns: int, rows: int) -> Text:
        now_ns = time.monotonic_ns()
        with self.lock:
            self.model.look(now_ns, _wall())
            return picture(self.model, now_ns, self._where, columns, rows)


def _wall() -> datetime:
    return datetime.now().astimezone()


def _check_accepted(ack: Ack | LeaseAck) -> None:
    if not ack.accepted:
        raise RejectedError(ack.reason or "", ack.detail or "")
