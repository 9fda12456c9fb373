"""Sends the commands of `replay` at their times."""

import gc
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.errors import GatewayError, RejectedError, StoppedError
from gateway.people.client.blocking import Client
from gateway.people.client.lease import NOT_OURS
from gateway.people.client.stream import ALL_STOPPED
from gateway.people.client.subscriptions import reports, subscribed
from gateway.people.recordings.replaying import Plan, ReplayStep
from gateway.people.terminal import clear_line, on_end_signals, show_line
from schemas.keys import EVENT
from schemas.telemetry import Event, Kind

BEGIN_S: Final = 0.1
"""From the last preparation to the first command."""
SLIP_NS: Final = 2 * NS_PER_MS
"""A command that is later (a busy laptop) delays all that follow: setpoints in a burst would replace one another."""
LATE_NS: Final = 200 * NS_PER_MS
"""A replay that falls so far behind at once (a laptop that slept) ends: the watchdog's default is 250 ms."""
LAST_NS: Final = 100 * NS_PER_MS
"""From the last command to the Stops at the end. A command that is read together with a Stop is rejected, as if the
replay had failed; it takes milliseconds to be read, and at the default rate 20 ms to its rate slot."""
MOST_AHEAD: Final = 100
"""Steps that are read before their time: two seconds of a gait. A chunk of the file takes 2 ms."""
FREE_NS: Final = 2 * NS_PER_MS
"""Before the next command there must be so much time for a step to be read."""
_PROGRESS_S: Final = 0.5


class Player:
    """Sends the steps in their time, ends at a rejection or a Stop, and leaves all legs stopped."""

    def __init__(
        self,
        client: Client,
        recorded: Plan,
        steps: Iterator[ReplayStep],
        speed: float,
    ) -> None:
        """`recorded` sums up what `steps` come to. They are read while others are sent."""
        self._client = client
        self._plan = recorded
        self._steps = steps
        self._ahead: deque[ReplayStep] = deque()
        self._speed = speed
        self._ended: Exception | None = None
        self._wake = threading.Event()
        self._over = threading.Event()
        self._begun_ns = 0
        self.sent = 0
        """Commands."""
        self._slipped_ns = 0
        """By how much all that is still to come is later than in the recording."""

    def run(self) -> None:
        """Play it to its end.

        Raises RejectedError or StoppedError where something ends it before its time.
        """
        interrupted = StoppedError("the replay was ended; all legs are stopped", ())
        with self._receives(), on_end_signals(lambda: self._end(interrupted)):
            self._begun_ns = time.monotonic_ns() + round(BEGIN_S * 1e9)
            sender = threading.Thread(target=self._send, name="sender")
            try:
                sender.start()
                while not self._over.wait(_PROGRESS_S):
                    self._show()
            finally:
                self._wake.set()
                sender.join()
                if not self._is_somebody_elses():
                    self._client.stop()
        if self._ended is not None:
            raise self._ended

    def _send(self) -> None:
        try:
            if self._play():
                self._wait_until(time.monotonic_ns() + LAST_NS)
        except GatewayError as error:
            self._end(error)
        finally:
            self._over.set()

    def _play(self) -> bool:
        """False: something has ended it."""
        while self._ahead or self._read_a_step():
            step = self._ahead.popleft()
            due_ns = self._begun_ns + self._slipped_ns + round(step.at_ns / self._speed)
            if not self._wait_until(due_ns):
                return False
            late_ns = time.monotonic_ns() - due_ns
            if late_ns > LATE_NS:
                self._end(StoppedError(f"this machine fell {late_ns / 1e6:.0f} ms behind; all legs are stopped", ()))
                return False
            if late_ns > SLIP_NS:
                self._slipped_ns += late_ns
            self._client.publish(step.key, step.payload())
            self.sent += 1
        return True

    def _read_a_step(self) -> bool:
        """Read one more of those to come; False: there is none, or enough of them are read."""
        step = next(self._steps, None) if len(self._ahead) < MOST_AHEAD else None
        if step is not None:
            self._ahead.append(step)
        return step is not None

    def _wait_until(self, due_ns: int) -> bool:
        """Read further steps meanwhile. False: something has ended it."""
        while due_ns - time.monotonic_ns() > FREE_NS and self._read_a_step():
            pass
        while (left_ns := due_ns - time.monotonic_ns()) > 0:
            if self._wake.wait(left_ns / 1e9):
                break
        return not self._wake.is_set()

    def _is_somebody_elses(self) -> bool:
        """Whether somebody else has the lease by now: a takeover has stopped all legs, and what runs now is theirs."""
        return isinstance(self._ended, RejectedError) and self._ended.reason in NOT_OURS

    def _end(self, why: Exception) -> None:
        self._ended = self._ended or why
        self._wake.set()

    def _show(self) -> None:
        total_s = self._plan.duration_ns / self._speed / 1e9
        show_line(f"{(time.monotonic_ns() - self._begun_ns) / 1e9:.1f} of {total_s:.1f} s")

    @contextmanager
    def _receives(self) -> Iterator[None]:
        with subscribed(self._client.session, {EVENT: reports(Event, self._take_event)}):
            self._client.state()  # its reply shows that it knows the subscription, which was declared before
            try:
                yield
            finally:
                clear_line()

    def _take_event(self, event: Event) -> None:
        if event.kind == Kind.COMMAND_REJECTED and event.source == self._client.name:
            legs = "the new driver has the legs now" if event.reason in NOT_OURS else "all legs are stopped"
            self._end(RejectedError(str(event.reason), f"{event.detail} ({event.key}); {legs}"))
        elif event.kind in ALL_STOPPED:
            self._end(StoppedError(f"the replay ends: {event.kind}: {event.detail}", ()))


@contextmanager
def without_pauses() -> Iterator[None]:
    """No garbage collection meanwhile: with an hour of steps in memory one takes a quarter of a second, or more.

    The first one is made here, so this goes before the lease, which nobody renews while it lasts.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()
