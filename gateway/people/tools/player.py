"""What `replay` sends, in its time, and what the gateway writes meanwhile.

One thread sends, and between two commands it takes the frames that have come. No other thread of Python runs then, so
none keeps the interpreter's lock from it; and Zenoh's threads never wait for that lock. Against a simulated controller
it has real-time priority. Measured with both cores busy with other work, half a minute of a gait: from a command's time
to Zenoh up to 7.6 ms without all this, and from there to the link up to 12.8 ms; with it 1.8 and 1.3 ms.
"""

import gc
import threading
import time
from array import array
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from typing import Any, Final

from pydantic import ValidationError
from zenoh.handlers import RingChannel

from gateway.errors import ConfigError, GatewayError, RejectedError, StoppedError
from gateway.people.client.blocking import Client
from gateway.people.client.lease import NOT_OURS
from gateway.people.client.live import reports, subscribed
from gateway.people.recordings.comparing import NS_PER_MS, Frames, Sent, Written
from gateway.people.recordings.replaying import Expected, Plan, Step
from gateway.people.terminal import clear_line, on_end_signals, show_line
from gateway.robot.host.realtime import prefer_all_threads, prefer_thread
from schemas.keys import EVENT, FRAME
from schemas.telemetry import Cause, Event, FrameRecord, Kind

BEGIN_S: Final = 0.1
"""From the last preparation to the first command."""
SLIP_NS: Final = 2 * NS_PER_MS
"""What is later than this (a busy laptop) delays all that follows: setpoints in a burst would replace one another."""
LATE_NS: Final = 200 * NS_PER_MS
"""A replay that falls so far behind at once (a laptop that slept) ends: the watchdog's default is 250 ms."""
AFTERWARDS_S: Final = 0.5
"""For the repeats of the last Stops, and for what is still on its way here."""
LAST_NS: Final = 100 * NS_PER_MS
"""From the last command to the Stops at the end. A command that is read together with a Stop is rejected, as if the
replay had failed; it takes milliseconds to be read, and at the default rate 20 ms to its rate slot."""
NO_FRAMES_NS: Final = 2000 * NS_PER_MS
"""A gateway that publishes frames has published one by then."""
MOST_AHEAD: Final = 100
"""Steps that are read before their time: two seconds of a gait. A chunk of the file takes 2 ms."""
FREE_NS: Final = 2 * NS_PER_MS
"""Before the next command there must be so much time for a frame to be looked at, which takes 20 µs, or for a step."""
MOST_UNREAD: Final = 65536
"""Frames that nobody has looked at yet: minutes of them."""
PROGRESS_S: Final = 0.5
PRIORITY: Final = 1
"""Below the gateway's own threads."""

_ENDS: Final = (Kind.ESTOP_ENGAGED, Kind.BUS_FAULT, Kind.STOPPED_OUTSIDE, Kind.STOPPING)


class Player:
    """Sends the steps in their time, watches what comes of it, and leaves all legs stopped."""

    def __init__(
        self,
        client: Client,
        recorded: Plan,
        steps: Iterator[Step],
        speed: float,
        *,
        expected: Expected | None,
        on_time: bool = False,
    ) -> None:
        """`recorded` sums up what `steps` come to. They are read while others are sent, and `expected` grows with them.

        `on_time`: real-time priority, where it is granted; not where a real robot's Stop could wait for it.
        """
        self._client = client
        self._plan = recorded
        self._steps = steps
        self._ahead: deque[Step] = deque()
        self._speed = speed
        self._expected = expected
        self._needs_frames = expected is not None
        self._on_time = on_time
        self._ended: Exception | None = None
        self._wake = threading.Event()
        self._over = threading.Event()
        self._frames: Any = None
        self._begun_ns = 0
        self.written = Frames()
        self.sent = Sent()
        self.late_ns = array("q")
        """Of each step, how long after its time it was handed to Zenoh."""
        self.slipped_ns = 0
        """By how much all that is still to come is later than in the recording."""

    def run(self, lease: Mapping[str, str]) -> None:
        """Commands carry the `lease` that this user has acquired beforehand.

        Raises RejectedError, StoppedError or ConfigError where something ends it before its time.
        """
        interrupted = StoppedError("the replay was ended; all legs are stopped", ())
        on_time = prefer_all_threads(PRIORITY) if self._on_time else nullcontext()
        with self._receives(), on_end_signals(lambda: self._end(interrupted)), on_time:
            self._begun_ns = time.monotonic_ns() + round(BEGIN_S * 1e9)
            sender = threading.Thread(target=self._send, args=(lease,), name="sender")
            try:
                sender.start()
                while not self._over.wait(PROGRESS_S):
                    self._show()
            finally:
                self._wake.set()
                sender.join()
                if not self._is_somebody_elses():
                    self._client.stop()
        if self._ended is not None:
            raise self._ended

    def _send(self, lease: Mapping[str, str]) -> None:
        try:
            if self._on_time:
                prefer_thread(PRIORITY)
            if not self._play(lease):
                return
            if self._expected is None:
                self._wait_until(time.monotonic_ns() + LAST_NS)
                return
            last_ns = self._expected.frames.at_ns[-1] + self.slipped_ns
            self._wait_until(self._begun_ns + last_ns + round(AFTERWARDS_S * 1e9))
            while self._look_at_a_frame():
                pass
        except GatewayError as error:
            self._end(error)
        finally:
            self._over.set()

    def _play(self, lease: Mapping[str, str]) -> bool:
        """False: something has ended it."""
        while self._ahead or self._read_a_step():
            step = self._ahead.popleft()
            due_ns = self._begun_ns + self.slipped_ns + round(step.at_ns / self._speed)
            if not self._wait_until(due_ns):
                return False
            late_ns = time.monotonic_ns() - due_ns
            if late_ns > LATE_NS:
                self._end(StoppedError(f"this machine fell {late_ns / 1e6:.0f} ms behind; all legs are stopped", ()))
                return False
            if late_ns > SLIP_NS:
                self.slipped_ns += late_ns
            self._publish(step, lease)
            if self._needs_frames and not self.written and due_ns - self._begun_ns > NO_FRAMES_NS:
                self._end(
                    ConfigError(
                        "the gateway publishes no frames, so nothing can be compared; start it with "
                        "HEXAPOD_TELEMETRY__FRAMES=true"
                    )
                )
        return True

    def _read_a_step(self) -> bool:
        """Read one more of those to come; False: there is none, or enough of them are read."""
        step = next(self._steps, None) if len(self._ahead) < MOST_AHEAD else None
        if step is not None:
            self._ahead.append(step)
        return step is not None

    def _publish(self, step: Step, lease: Mapping[str, str]) -> None:
        payload = {**step.payload(), **lease}
        begun_ns = time.monotonic_ns() - self._begun_ns
        self._client.publish(step.key, payload)
        done_ns = time.monotonic_ns() - self._begun_ns
        self.sent.append(begun_ns, done_ns)
        self.late_ns.append(done_ns - step.at_ns)

    def _wait_until(self, due_ns: int) -> bool:
        """Look at the frames that were received meanwhile. False: something has ended it."""
        while due_ns - time.monotonic_ns() > FREE_NS and (self._look_at_a_frame() or self._read_a_step()):
            pass
        while (left_ns := due_ns - time.monotonic_ns()) > 0:
            if self._wake.wait(left_ns / 1e9):
                break
        return not self._wake.is_set()

    def _look_at_a_frame(self) -> bool:
        sample = self._frames.try_recv() if self._needs_frames else None
        if sample is None:
            return False
        with suppress(ValidationError, ValueError):
            record = FrameRecord.model_validate_json(sample.payload.to_bytes())
            if self.written or record.cause == Cause.COMMAND:  # not the repeats of Stops before
                commanded = record.cause not in (Cause.REPEAT, Cause.WATCHDOG)
                self.written.append(Written(record.monotonic_ns, bytes.fromhex(record.bytes), commanded))
        return True

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
        handlers: dict[str, Any] = {EVENT: reports(Event, self._take_event)}
        if self._needs_frames:
            handlers[FRAME] = RingChannel(MOST_UNREAD)
        with subscribed(self._client.session, handlers) as subscribers:
            self._frames = subscribers[-1]
            self._client.state()  # it has answered, so it knows of the subscriptions, which were declared before
            try:
                yield
            finally:
                clear_line()

    def _take_event(self, event: Event) -> None:
        if event.kind == Kind.COMMAND_REJECTED and event.source == self._client.name:
            legs = "whoever drives has the legs now" if event.reason in NOT_OURS else "all legs are stopped"
            self._end(RejectedError(str(event.reason), f"{event.detail} ({event.key}); {legs}"))
        elif event.kind in _ENDS:
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
