"""`replay`: the frames of a recording as commands again, in their time; and whether the gateway writes the same."""

import gc
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import zenoh
from pydantic import ValidationError

from gateway.client import Client
from gateway.errors import ConfigError, RejectedError, StoppedError
from gateway.recordings import read
from gateway.recordings.replaying import NS_PER_MS, Plan, Written, compare, delayed, plan
from gateway.tools.driving import drives
from gateway.tools.ending import on_end_signals
from gateway.tools.reach import Connection
from gateway.tools.terminal import hint, say
from schemas.keys import EVENT, FRAME, STATE
from schemas.telemetry import Cause, Event, FrameRecord, GatewayState, Kind, Mode

SOURCE: Final = "hexapod-gateway replay"
BEGIN_S: Final = 0.1
"""From the last preparation to the first command."""
SLIP_NS: Final = 2 * NS_PER_MS
"""What is later than this (a busy laptop) delays all that follows: setpoints in a burst would replace one another."""
LATE_NS: Final = 200 * NS_PER_MS
"""A replay that falls so far behind at once (a laptop that slept) ends: the watchdog's default is 250 ms."""
AFTERWARDS_S: Final = 0.5
"""For the repeats of the last Stops, and for what is still on its way here."""
NO_FRAMES_S: Final = 2.0
"""A gateway that publishes frames has published one by then."""
TOLERANCE_MS: Final = 5.0
PROGRESS_S: Final = 0.5

_ENDS: Final = (Kind.ESTOP_ENGAGED, Kind.BUS_FAULT, Kind.STOPPED_OUTSIDE, Kind.STOPPING)


def replay(
    connect: Connection, path: Path, *, speed: float, check: bool, agreed: bool, tolerance_ms: float = TOLERANCE_MS
) -> int:
    """Replay `path` and return the exit code. Raises ConfigError, RejectedError, StoppedError, ZenohError."""
    if check and speed != 1:
        raise ConfigError("--check compares times, so it goes with --speed 1")
    recorded = plan(_frames(path), watchdog_too=speed != 1)
    _look_at(path, recorded)
    with connect() as client:
        state = client.state()
        _fit(state, recorded, speed)
        if check and not state.simulated:
            hint("This is a real controller; what it writes is compared all the same.")
        if not state.simulated:
            _ask(recorded, speed, agreed=agreed)
        player = _Player(client, recorded, speed, needs_frames=check)
        with drives(client, recorded.duration_ns / speed / 1e9 + 1, moves=True) as lease:
            player.run(lease)
    said = f"{len(recorded.steps)} commands in {recorded.duration_ns / speed / 1e9:.1f} s"
    if not check:
        say(f"replayed: {said}")
        return 0
    return _report(recorded, player, said, tolerance_ms)


def _frames(path: Path) -> Iterator[dict[str, Any]]:
    """The recorded frames. Raises ConfigError where their angles are not those that commands count in."""
    for message in read(path):
        if message.topic == FRAME:
            yield message.content
        elif message.topic == STATE and message.content.get("calibration", {}).get("revision"):
            raise ConfigError(
                f"{path}: this robot was calibrated, so its frames carry other angles than commands; nothing is sent"
            )


def _look_at(path: Path, recorded: Plan) -> None:
    if not recorded.steps:
        raise ConfigError(
            f"{path}: has no frames that commands caused; record with telemetry.frames = true at the gateway"
        )
    if recorded.begun_running:
        hint(f"The recording begins while servos run: {recorded.begun_running} first Sets are sent as Starts.")
    if recorded.left_out:
        hint(f"{recorded.left_out} frames are left out: after a new start of the gateway's machine, or of no protocol.")


def _fit(state: GatewayState, recorded: Plan, speed: float) -> None:
    """Raises ConfigError where this gateway cannot follow."""
    if state.mode is not Mode.IDLE:
        raise ConfigError(f"the robot is not at rest (its mode is {state.mode}); nothing is sent")
    gap_ms = recorded.longest_gap_ns / NS_PER_MS / speed
    if speed != 1 and gap_ms > state.watchdog.timeout_ms:
        raise ConfigError(
            f"at --speed {speed:g} there are {gap_ms:.0f} ms between two setpoints of a leg, and the watchdog stops it "
            f"after {state.watchdog.timeout_ms:g} ms; a faster replay goes"
        )


def _ask(recorded: Plan, speed: float, *, agreed: bool) -> None:
    """A real robot moves only with consent."""
    legs = sorted({frame.servos[0][0] // 10 for step in recorded.steps for frame in step.frames})
    what = (
        f"This is a real robot. Its legs {', '.join(map(str, legs))} will go to where the recording begins at once, as "
        f"fast as they can, and then move for {recorded.duration_ns / speed / 1e9:.0f} s. Ctrl-C stops them."
    )
    hint(what)
    if agreed:
        return
    if not sys.stdin.isatty():
        raise ConfigError("nobody can be asked here, since there is no terminal; --yes agrees")
    sys.stderr.write("Is it free to move, with somebody at the switch of its supply? [y/N] ")
    sys.stderr.flush()
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise ConfigError("nothing was sent")


class _Player:
    """Sends the steps in their time, hears what comes of it, and leaves all legs stopped."""

    def __init__(self, client: Client, recorded: Plan, speed: float, *, needs_frames: bool) -> None:
        self._client = client
        self._plan = recorded
        self._speed = speed
        self._needs_frames = needs_frames
        self._ended: Exception | None = None
        self._wake = threading.Event()
        self.written: list[Written] = []
        self.delays: list[tuple[int, int]] = []
        """From which step on, and by how much, this machine was late."""

    def run(self, lease: Mapping[str, str]) -> None:
        """Commands carry the `lease` that this user has acquired beforehand.

        Raises RejectedError, StoppedError or ConfigError where something ends it before its time.
        """
        interrupted = StoppedError("the replay was ended; all legs are stopped", ())
        with self._hears(), _without_pauses(), on_end_signals(lambda: self._end(interrupted)):
            begun_ns = time.monotonic_ns() + round(BEGIN_S * 1e9)
            try:
                self._play(begun_ns, lease)
                if self._needs_frames:
                    self._wake.wait(max(0.0, self._after_last_s(begun_ns)))
            finally:
                self._client.stop()
        if self._ended is not None:
            raise self._ended

    def _after_last_s(self, begun_ns: int) -> float:
        last_ns = begun_ns + self._plan.expected[-1].at_ns + sum(late_ns for _, late_ns in self.delays)
        return (last_ns - time.monotonic_ns()) / 1e9 + AFTERWARDS_S

    def _play(self, begun_ns: int, lease: Mapping[str, str]) -> None:
        progress_ns = begun_ns
        for step in self._plan.steps:
            due_ns = begun_ns + round(step.at_ns / self._speed)
            while (left_ns := due_ns - time.monotonic_ns()) > 0:
                if self._wake.wait(min(left_ns / 1e9, PROGRESS_S)):
                    return
                progress_ns = self._show(progress_ns, begun_ns)
            if self._wake.is_set():
                return
            if -left_ns > LATE_NS:
                self._end(StoppedError(f"this machine fell {-left_ns / 1e6:.0f} ms behind; all legs are stopped", ()))
                return
            if -left_ns > SLIP_NS:
                begun_ns -= left_ns
                self.delays.append((step.at_ns, -left_ns))
            self._client.publish(step.key, {**step.payload(), **lease})
            if self._needs_frames and not self.written and time.monotonic_ns() - begun_ns > NO_FRAMES_S * 1e9:
                self._end(
                    ConfigError(
                        "the gateway publishes no frames, so nothing can be compared; start it with "
                        "HEXAPOD_TELEMETRY__FRAMES=true"
                    )
                )

    def _end(self, why: Exception) -> None:
        self._ended = self._ended or why
        self._wake.set()

    def _show(self, progress_ns: int, begun_ns: int) -> int:
        now_ns = time.monotonic_ns()
        if now_ns < progress_ns or not sys.stderr.isatty():
            return progress_ns
        total_s = self._plan.duration_ns / self._speed / 1e9
        sys.stderr.write(f"\r\x1b[K{(now_ns - begun_ns) / 1e9:.1f} of {total_s:.1f} s")
        sys.stderr.flush()
        return now_ns + round(PROGRESS_S * 1e9)

    @contextmanager
    def _hears(self) -> Iterator[None]:
        session = self._client.session
        subscribers: list[Any] = [session.declare_subscriber(EVENT, self._take_event)]
        if self._needs_frames:
            subscribers.append(session.declare_subscriber(FRAME, self._take_frame))
        self._client.state()  # the gateway has answered, so it knows of the subscriptions, which were declared before
        try:
            yield
        finally:
            for subscriber in subscribers:
                with suppress(zenoh.ZError):
                    subscriber.undeclare()
            if sys.stderr.isatty():
                sys.stderr.write("\r\x1b[K")
                sys.stderr.flush()

    def _take_event(self, sample: zenoh.Sample) -> None:
        with suppress(ValidationError):
            event = Event.model_validate_json(sample.payload.to_bytes())
            if event.kind == Kind.COMMAND_REJECTED and event.source == self._client.name:
                self._end(RejectedError(str(event.reason), f"{event.detail} ({event.key}); all legs are stopped"))
            elif event.kind in _ENDS:
                self._end(StoppedError(f"the replay ends: {event.kind}: {event.detail}", ()))

    def _take_frame(self, sample: zenoh.Sample) -> None:
        with suppress(ValidationError, ValueError):
            record = FrameRecord.model_validate_json(sample.payload.to_bytes())
            if self.written or record.cause == Cause.COMMAND:  # not the repeats of Stops before
                commanded = record.cause not in (Cause.REPEAT, Cause.WATCHDOG)
                self.written.append(Written(record.monotonic_ns, bytes.fromhex(record.bytes), commanded))


@contextmanager
def _without_pauses() -> Iterator[None]:
    """No garbage collection meanwhile: with an hour of steps in memory one takes a quarter of a second."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()


def _report(recorded: Plan, player: _Player, said: str, tolerance_ms: float) -> int:
    expected = list(delayed(recorded.expected, player.delays))
    written = player.written[: len(expected)] if len(player.written) > len(expected) else player.written
    found = compare(expected, written)
    for difference in found.differences:
        say(difference)
    say(
        f"{'the same' if found.passes(tolerance_ms) else 'NOT the same'}: {said}; {found.frames} frames expected, "
        f"{len(written)} written, {found.swapped} overtaken by another leg's, "
        f"at most {found.worst_ms:.2f} ms from their time (p99 {found.p99_ms:.2f} ms)"
    )
    if player.delays:
        late_ms = sum(late_ns for _, late_ns in player.delays) / NS_PER_MS
        hint(f"This machine was busy: it sent {late_ms:.0f} ms later in the end, and times are compared with that.")
    return 0 if found.passes(tolerance_ms) else 1
