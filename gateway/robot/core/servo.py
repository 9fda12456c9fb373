"""The life of one servo. Pure; the rules that decide each step are elsewhere. No other file assigns a servo's fields.

| state   | known                                                   | left by                          |
|---------|---------------------------------------------------------|----------------------------------|
| off     | where it was stopped, and when (`known`)                | `take` of a start                |
| waiting | its target, the command, the angle of its power         | `wrote_…`, `drop`, `stop`        |
| running | the angle last written; perhaps a target on its way     | `stop`                           |

`AFTER` has every transition. A call that it does not have raises IllegalTransition, and changes nothing.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, NamedTuple

from gateway.model.calibration import RobotCalibration
from gateway.model.frames import OP_SET, OP_START, SETS, STARTS, ServoOp
from gateway.robot.core.events import NOBODY, Command, Sender, Targets


class Life(StrEnum):
    """Whether a servo is off, waits to be started, or runs."""

    OFF = "off"
    WAITING = "waiting"
    RUNNING = "running"


OFF: Final = Life.OFF
WAITING: Final = Life.WAITING
RUNNING: Final = Life.RUNNING

AFTER: Final[Mapping[str, Mapping[Life, Life]]] = {
    "start": {OFF: WAITING, WAITING: WAITING, RUNNING: RUNNING},
    "set": {WAITING: WAITING, RUNNING: RUNNING},
    "frame": {WAITING: RUNNING, RUNNING: RUNNING},
    "drop": {OFF: OFF, WAITING: OFF, RUNNING: RUNNING},
    "stop": {OFF: OFF, WAITING: OFF, RUNNING: OFF},
}
"""The state after each event, by the state before it."""
_START, _SET, _FRAME, _DROP = AFTER["start"], AFTER["set"], AFTER["frame"], AFTER["drop"]
_NO_COMMAND: Final = Command(())


class IllegalTransition(RuntimeError):  # noqa: N818  (as IllegalEvent)
    """A servo in this state has no such event; nothing has changed."""


class Known(NamedTuple):
    """Where a servo was when it was stopped."""

    angle_cdeg: int
    stopped_ns: int
    calibration: RobotCalibration
    """The calibration of the angle."""


@dataclass(slots=True, eq=False)
class Servo:  # mutants accepted (Step): set before it is read
    """One servo. Angles are users', in hundredths of a degree."""

    servo_id: int
    life: Life = OFF
    angle_cdeg: int | None = None
    """The angle last written, while it runs; None: its angle is unknown."""
    target: ServoOp | None = None
    """The newest operation that no frame has completed: a start, or a set."""
    command: Command = _NO_COMMAND
    """The command of `target`."""
    begun: bool = False  # mutants accepted (FalseWithTrue): set before it is read
    """Whether a frame has made a step towards `target`, since the servo's speed is limited. Its command is done."""
    from_cdeg: int | None = None
    """The angle at which its waiting start begins: where it stood, if known, or if supply starts servos, the first
    target. None: at the newest target."""
    pace_cdeg_s: int | None = None
    """The highest speed to its present target (take-over, landing), besides its own limit; None: no such limit."""
    since_ns: int = 0
    """When the time for its next step begins, if its speed is limited."""
    passing_cdeg: int | None = None
    """Its computed angle within a range that is never sent, at whose near end it waits."""
    sender: Sender = NOBODY
    """Who started or set it last."""
    known: Known | None = None
    """Where its latest Stop found it; None: it never ran, or that is not known any more."""
    stopped_ns: int | None = None
    stopped_by: frozenset[str] = frozenset()
    """The channels of the commands, or the gateway's own causes, that stopped it at `stopped_ns`."""

    @property
    def running(self) -> bool:
        return self.life is RUNNING

    @property
    def will_run(self) -> bool:
        """Whether the servo runs or waits to be started, so that a `set` applies to it."""
        return self.life is not OFF

    @property
    def pending(self) -> bool:
        """Whether no frame has carried out its newest command yet."""
        return self.target is not None and not self.begun

    # ---- its transitions

    def take(self, op: ServoOp, command: Command, from_cdeg: int | None = None) -> None:
        """Take a start or a set as the newest target. A pending start stays a start, also of a running servo.

        `from_cdeg` is where a start begins. A waiting start keeps this angle, however long it waits.
        """
        life = (_START if op.op is OP_START else _SET).get(self.life)
        if life is None:
            raise IllegalTransition(f"servo {self.servo_id} is {self.life}, and is set")
        if self.life is OFF:
            self.from_cdeg = from_cdeg
        self.life = life
        self.sender = command.sender
        waits = self.target is not None and self.target.op is OP_START
        self.target = STARTS[op.angle_cdeg] if waits and op.op is OP_SET else op
        self.command, self.begun = command, False

    def land(self, angle_cdeg: int, pace_cdeg_s: int, now_ns: int) -> None:
        """Let a running servo go to its landing angle, for no command."""
        self.target, self.begun = SETS[angle_cdeg], True
        self.pace_cdeg_s, self.since_ns = pace_cdeg_s, now_ns

    def ease(self, pace_cdeg_s: int, since_ns: int) -> None:
        """Limit the speed to its target. The time for the first step begins at `since_ns`."""
        self.pace_cdeg_s, self.since_ns = pace_cdeg_s, since_ns

    @property
    def newest(self) -> ServoOp:
        """The target that a frame may carry out. Raises IllegalTransition if there is none."""
        if self.target is None:
            raise IllegalTransition(f"servo {self.servo_id} is {self.life} without a target, and a frame moves it")
        return self.target

    def wrote_target(self, now_ns: int) -> ServoOp:
        """Record a frame with its target, and return that operation."""
        op = self.newest
        self.life, self.angle_cdeg, self.since_ns = _FRAME[self.life], op.angle_cdeg, now_ns
        self.target = self.pace_cdeg_s = self.from_cdeg = self.passing_cdeg = None
        return op

    def wrote_step(self, op: ServoOp, since_ns: int, passing_cdeg: int | None) -> None:
        """Record a frame with a step towards its target. The time for the next step begins at `since_ns`."""
        target = self.newest
        if op.angle_cdeg == target.angle_cdeg:
            self.wrote_target(since_ns)
            return
        self.life, self.angle_cdeg, self.from_cdeg = _FRAME[self.life], op.angle_cdeg, None
        self.since_ns, self.passing_cdeg = since_ns, passing_cdeg
        self.target, self.begun = SETS[target.angle_cdeg], True

    def repeated(self, now_ns: int) -> None:
        """Record a frame that repeats its state: the time for its next step begins."""
        self.since_ns = now_ns

    def drop(self) -> None:
        """Drop its target. A running servo stays at its angle."""
        self.life = _DROP[self.life]
        self.target = self.from_cdeg = self.passing_cdeg = None

    def stop(self, by: str, instant_ns: int, now_ns: int, calibration: RobotCalibration | None) -> None:
        """Record a Stop by this channel or cause. `calibration` is its angle's; None: its last frame is unknown."""
        earlier = self.stopped_by if self.stopped_ns == instant_ns else frozenset[str]()
        self.stopped_by, self.stopped_ns = earlier | {by}, instant_ns
        if calibration is None:
            self.known = None
        elif self.angle_cdeg is not None:
            self.known = Known(self.angle_cdeg, now_ns, calibration)
        self.life = OFF
        self.angle_cdeg = self.target = self.from_cdeg = self.passing_cdeg = self.pace_cdeg_s = None


def moved(servos: Mapping[int, Servo], targets: Targets) -> None:
    """Record frames that move running servos without a target to other angles. Raises IllegalTransition at another.

    No limit of their speed applies, so the time for a next step is not kept.
    """
    for servo_id, op in targets:
        servo = servos[servo_id]
        if servo.life is not RUNNING or servo.target is not None:
            raise IllegalTransition(f"servo {servo_id} is {servo.life}, and a frame moves it")
        servo.angle_cdeg = op.angle_cdeg
