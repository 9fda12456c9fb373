"""The means of a step: one servo, a client, and all that the gateway writes and publishes meanwhile."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

from gateway.errors import GatewayError, UnansweredError
from gateway.model.calibration import RobotCalibration, calibration_of
from gateway.model.frames import Frame, FrameError, OneLeg, OneServo, Op, ServoOp, centidegrees, decode
from gateway.people.client.blocking import Client
from gateway.people.client.subscriptions import reports, subscribed
from gateway.people.commands.moving import ServoMotion
from schemas import keys
from schemas.robot import JOINTS
from schemas.telemetry import Ack, Cause, Event, FrameRecord, GatewayState, Kind, Reason

SETPOINT_PERIOD_S: Final = 0.02
STREAM_S: Final = 0.3
"""How long setpoints stream before the step acts."""
QUIET_S: Final = 0.15
"""After this time all pending frames are sent: a leg's rate slot comes every 20 ms."""
_POLL_S: Final = 0.01

Figures = dict[str, float | int | str]
"""Measured by a step; names carry the units."""


class FailedError(Exception):
    """A step fails; the sentence states what was seen instead."""


class Skipped(Exception):  # noqa: N818  (it is no error)
    """A step cannot be done here; the sentence states why."""


def demand(true: object, sentence: str) -> None:
    """Fail the step with this sentence, unless it is true."""
    if not true:
        raise FailedError(sentence)


class WrittenFrame(NamedTuple):
    """A frame that the gateway wrote."""

    at_ns: int
    frame: Frame
    cause: str

    @property
    def moves(self) -> bool:
        """Whether it starts or sets a servo."""
        return any(command.op is not Op.STOP for _, command in self.frame.servos)


class StopsOptions(NamedTuple):
    """What the command line of `check --stops` states."""

    leg: int = 1
    agreed: bool = False
    only: Sequence[str] = ()
    late_ms: float = 20.0
    """How late a Stop may be. With every core busy 2.9 ms were measured; 100 ms are a fault."""
    restart: bool = False
    """Whether the service may be killed."""
    unplug: bool = False
    """Whether a person is there who unplugs things."""
    config: Path | None = None
    as_json: bool = False


@dataclass(slots=True)
class Bench:
    """One leg of one robot."""

    client: Client
    motion: ServoMotion
    options: StopsOptions
    calibration: RobotCalibration = field(default_factory=RobotCalibration)
    frames_published: bool = False
    answer_ms: float = 0.0
    """How long the gateway takes to answer at rest."""
    estop: int = 0
    """The number of this program's own emergency stop."""
    frames: list[WrittenFrame] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)

    # ---- commands

    def frame(self, op: Op, angle_deg: float) -> Frame:
        """The frame that such a command is to cause, in the servos' own angles; the leg's, where the others hold."""
        motion, angles_deg = self.motion, {**self.motion.holding, self.motion.servo_id: angle_deg}
        if not motion.holding:
            return self.calibration.frame(OneServo(motion.servo_id, ServoOp(op, centidegrees(angle_deg))))
        one, two, three = (ServoOp(op, centidegrees(angles_deg[10 * motion.leg + joint])) for joint in JOINTS)
        return self.calibration.frame(OneLeg(motion.leg, (one, two, three)))

    def ask(self, op: str, angle_deg: float, reason: Reason | None = None) -> None:
        """An acknowledged start or set. Fails the step unless it is accepted, or rejected for this reason."""
        self.demand(self.client.ask(self.motion.key, self.motion.payload(op, angle_deg)), f"a {op}", reason)

    def demand(self, ack: Ack, what: str, reason: Reason | None = None) -> None:
        """Fail the step unless the command was accepted, or rejected for this reason."""
        found = "accepted" if ack.accepted else f"rejected: {ack.reason}: {ack.detail}"
        demand(ack.reason == reason, f"{what} was {found}; wanted: {reason or 'accepted'}")

    def start(self, reason: Reason | None = None) -> None:
        """Start the leg, or see that it is rejected for this reason."""
        self.ask("start", self.motion.start_deg, reason)

    def reset(self) -> None:
        """Leave this program's own emergency stop."""
        self.demand(self.client.ask(keys.RESET, {"estop": self.estop}), "the reset")

    @contextmanager
    def streaming(self, lead_s: float = STREAM_S) -> Iterator[None]:
        """Start the leg, and publish setpoints at 50 Hz meanwhile, whatever the gateway answers."""
        self.start()
        ended = threading.Event()

        def stream() -> None:
            with suppress(GatewayError):
                while not ended.wait(SETPOINT_PERIOD_S):
                    self.client.publish(self.motion.key, self.motion.payload("set", self.motion.start_deg))

        thread = threading.Thread(target=stream, name="stream")
        thread.start()
        try:
            time.sleep(lead_s)
            yield
        finally:
            ended.set()
            thread.join()

    # ---- their effect

    def wait(self, condition: Callable[[], object], timeout_s: float) -> bool:
        """Wait until it holds. Returns False after `timeout_s`."""
        end_s = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() >= end_s:
                return False
            time.sleep(_POLL_S)
        return True

    def wait_for_event(self, kind: Kind, since: int, timeout_s: float) -> bool:
        """Wait for an event behind the first `since` ones."""
        return self.wait(lambda: any(each.kind == kind for each in self.events[since:]), timeout_s)

    def caused(self, cause: Cause, since: int, *, moves: bool) -> list[WrittenFrame]:
        """The frames of the leg since a mark that were written for this reason."""
        found = (each for each in self.frames[since:] if each.cause == cause and each.moves is moves)
        return [each for each in found if each.frame.leg == self.motion.leg]

    def running(self, state: GatewayState | None = None) -> list[int]:
        """The servos that run, of all legs, as the gateway reports them."""
        state = state or self.client.state()
        return [servo.id for leg in state.legs for servo in leg.servos if servo.running]

    def demand_no_motion(self, when: str, since: int | None = None) -> None:
        """Fail the step if a frame since the mark, or from now on, starts or sets a servo, or one runs."""
        since = len(self.frames) if since is None else since
        time.sleep(QUIET_S)
        moving = [seen.frame.to_bytes().hex() for seen in self.frames[since:] if seen.moves]
        demand(not moving, f"{when}, {len(moving)} frames moved a servo: {moving[:1]}")
        demand(not (running := self.running()), f"{when}, servos run: {running}")

    # ---- received

    @contextmanager
    def receives(self) -> Iterator[None]:
        """Frames and events are kept meanwhile."""
        taken = {keys.FRAME: reports(FrameRecord, self._take_frame), keys.EVENT: reports(Event, self.events.append)}
        with subscribed(self.client.session, taken):
            self.client.state()  # its reply shows that it knows the subscriptions, which were declared before
            yield

    def measure(self) -> None:
        """How soon the gateway answers, its calibration, and whether it publishes frames (a Stop shows it)."""
        took_ms = []
        for _ in range(5):
            begun_s = time.monotonic()
            self.client.state()
            took_ms.append((time.monotonic() - begun_s) * 1000)
        self.answer_ms = sorted(took_ms)[2]
        self.demand(self.client.stop(), "a Stop")
        self.frames_published = self.wait(lambda: self.frames, 1.0)
        with suppress(UnansweredError):  # a gateway that knows of no calibration
            self.calibration = calibration_of(self.client.calibration())

    def _take_frame(self, record: FrameRecord) -> None:
        with suppress(FrameError, ValueError):
            frame = decode(bytes.fromhex(record.bytes))
            self.frames.append(WrittenFrame(record.monotonic_ns, frame, str(record.cause)))
