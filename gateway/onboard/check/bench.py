"""The means of `check --move`, `--stops` and `--wire`: steps; one servo, a client, and what it receives meanwhile."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

from gateway.errors import GatewayError
from gateway.model.calibration import RobotCalibration, calibration_of
from gateway.model.frames import Frame, FrameError, decode
from gateway.onboard.check.table import show
from gateway.people.client.blocking import Client
from gateway.people.commands.moving import ServoMotion
from schemas import keys
from schemas.telemetry import Ack, Cause, Event, FrameRecord, Kind, Mode, Reason

_POLL_S: Final = 0.01
_SETPOINT_S: Final = 0.02
STREAM_S: Final = 0.3  # setpoints stream for this time before the step acts
_QUIET_S: Final = 0.15  # after this time all pending frames are sent: a leg's rate slot comes every 20 ms


class FailedError(GatewayError):
    """A step failed; the message states what happened instead."""


class Skipped(GatewayError):  # noqa: N818  (it is no error)
    """A step cannot be done here; the message states why."""


def demand(true: object, sentence: str) -> None:
    """Raise FailedError with this sentence unless `true` holds."""
    if not true:
        raise FailedError(sentence)


class CheckStep(NamedTuple):
    """One step: its name, a sentence for a person, and its function. That returns figures, or a better sentence."""

    name: str
    does: str
    run: Callable[[Any], dict[str, Any] | str | None]

    @classmethod
    def of(cls, run: Callable[[Any], dict[str, Any]]) -> Self:
        """Return the step of a function: its name and docstring are the step's."""
        return cls(run.__name__.replace("_", "-"), str(run.__doc__).rstrip("."), run)

    def outcome(self, means: object, held: AbstractContextManager[None], *, quiet: bool = False) -> dict[str, object]:
        """Run it while `held`, and print the result unless `quiet`. Return it as `--json` prints it."""
        result, figures = "PASS", dict[str, Any]()
        try:
            with held:
                found = self.run(means)
            figures = found if isinstance(found, dict) else figures
            each = {name: f"{value:.1f}" if isinstance(value, float) else value for name, value in figures.items()}
            detail = ", ".join(f"{name} {value}" for name, value in each.items()) or str(found or self.does)
        except GatewayError as error:
            result, detail = "SKIPPED" if isinstance(error, Skipped) else "FAIL", str(error)
        except Exception as error:  # of a plug-in, which is somebody else's code
            result, detail = "FAIL", f"{type(error).__name__}: {error}"
        if not quiet:
            show(self.name, result, detail)
        return {"step": self.name, "result": result, "detail": detail, "figures": figures}


class StopsOptions(NamedTuple):
    """The options of the command line. With every core busy, Stops were late by 2.9 ms at most."""

    leg: int = 1
    agreed: bool = False
    only: Sequence[str] = ()
    late_ms: float = 20.0
    restart: bool = False
    unplug: bool = False
    config: Path | None = None
    as_json: bool = False


class WrittenFrame(NamedTuple):
    """A frame that the gateway wrote, and when and why."""

    at_ns: int
    frame: Frame
    cause: str


@dataclass
class Bench:
    """The means of a step: commands for one servo, and the frames and events received since `forget`.

    A command fails the step unless it is accepted, or rejected for the expected `reason`.
    """

    client: Client
    motion: ServoMotion
    options: StopsOptions = StopsOptions()  # noqa: RUF009  (immutable)
    calibration: RobotCalibration = field(default_factory=RobotCalibration)
    frames_published: bool = False
    answer_ms: float = 0.0
    """How long the gateway takes to answer at rest."""
    estop: int = 0
    """The number of this program's own emergency stop."""
    frames: list[WrittenFrame] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)

    def listen(self) -> None:
        """Receive frames and events. A first Stop shows whether frames come, and how fast answers do."""
        self._subscribers = self.client.on_frame(self._take_frame), self.client.on_event(self.events.append)
        self.client.state()  # its reply shows that the gateway knows the subscriptions, which were declared before
        begun_s = time.monotonic()
        self.demand(self.client.stop(), "a Stop")
        self.answer_ms = ms_since(begun_s)
        self.frames_published = bool(self.wait(lambda: self.frames, 1.0))
        self.calibration = calibration_of(self.client.calibration())

    def _take_frame(self, record: FrameRecord) -> None:
        with suppress(FrameError, ValueError):
            frame = decode(bytes.fromhex(record.bytes))
            self.frames.append(WrittenFrame(record.monotonic_ns, frame, str(record.cause)))

    def forget(self) -> None:
        """Forget the frames and events received before now."""
        self.frames.clear()
        self.events.clear()

    def ask(self, op: str, angle_deg: float, reason: Reason | None = None) -> None:
        """Start or set (`op`) the servo, acknowledged. Raises FailedError."""
        self.demand(self.client.ask(self.motion.key, self.motion.payload(op, angle_deg)), f"a {op}", reason)

    def start(self, reason: Reason | None = None) -> None:
        """Start the servo, acknowledged. Raises FailedError."""
        self.ask("start", self.motion.start_deg, reason)

    def demand(self, ack: Ack, what: str, reason: Reason | None = None) -> None:
        """Raise FailedError unless `ack` is accepted (`reason`: rejected for this reason)."""
        found = "accepted" if ack.accepted else f"rejected: {ack.reason}: {ack.detail}"
        demand(ack.reason == reason, f"{what} was {found}" + (f"; wanted: {reason or 'accepted'}" if reason else ""))

    def reset(self) -> None:
        """End this program's own emergency stop. Raises FailedError if the gateway rejects it, or anything moves."""
        mark = len(self.frames)
        self.demand(self.client.ask(keys.RESET, {"estop": self.estop}), "the reset")
        self.demand_no_motion("after the reset", mark)

    def rest(self) -> None:
        """Stop all legs, and end the emergency stop that this program engaged."""
        self.client.stop()
        if self.estop and self.client.state().mode == Mode.ESTOPPED:
            with suppress(FailedError):  # rejected where somebody else has engaged a newer one
                self.reset()
        self.wait(lambda: self.client.state().mode in (Mode.IDLE, Mode.ESTOPPED), 2.0)

    @contextmanager
    def streaming(self, lead_s: float = STREAM_S) -> Iterator[None]:
        """Start the leg, and publish setpoints at 50 Hz during the `with`, also if they are rejected.

        The `with` begins after `lead_s`, without what was received before.
        """
        self.start()
        ended = threading.Event()

        def stream() -> None:
            with suppress(GatewayError):
                while not ended.wait(_SETPOINT_S):
                    self.client.publish(self.motion.key, self.motion.payload("set", self.motion.start_deg))

        thread = threading.Thread(target=stream, name="stream")
        thread.start()
        try:
            time.sleep(lead_s)
            self.forget()
            yield
        finally:
            ended.set()
            thread.join()

    def wait(self, condition: Callable[[], object], timeout_s: float) -> object:
        """Wait until `condition` holds, for `timeout_s` at most. Return its last value."""
        end_s = time.monotonic() + timeout_s
        while not (found := condition()) and time.monotonic() < end_s:
            time.sleep(_POLL_S)
        return found

    def wait_until_stopped(self) -> object:
        """Wait until no servo runs, for a second longer than the watchdog. Return whether none does."""
        return self.wait(lambda: not self.running(), self.client.state().watchdog.stops_after_ms / 1000 + 1)

    def wait_for_event(self, kind: Kind, timeout_s: float) -> object:
        """Wait for an event of this kind. Return whether it came."""
        return self.wait(lambda: any(each.kind == kind for each in self.events), timeout_s)

    def caused(self, cause: Cause, *, stops: bool) -> list[WrittenFrame]:
        """Return the leg's frames that were written for this cause, its Stops or its motions."""
        found = (each for each in self.frames if each.cause == cause and each.frame.is_stop is stops)
        return [each for each in found if each.frame.leg == self.motion.leg]

    def running(self) -> dict[int, float | None]:
        """Return the angles (degrees) of all servos that run, by id, as the gateway reports."""
        servos = (servo for leg in self.client.state().legs for servo in leg.servos)
        return {servo.id: servo.angle_deg for servo in servos if servo.running}

    def demand_no_motion(self, when: str, since: int | None = None) -> None:
        """Raise FailedError if a servo runs, or a frame since the mark (None: from now) starts or sets one."""
        since = len(self.frames) if since is None else since
        time.sleep(_QUIET_S)
        moving = [each.frame.to_bytes().hex() for each in self.frames[since:] if not each.frame.is_stop]
        demand(not moving, f"{when}, {len(moving)} frames moved a servo: {moving[:1]}")
        demand(not (running := self.running()), f"{when}, servos run: {[*running]}")


def ms_since(begun_s: float) -> float:
    return (time.monotonic() - begun_s) * 1000
