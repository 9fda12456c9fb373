"""`check --move`, the first contact: start one servo, move it by 5°, and stop it. With the means of `check --stops`.

A person agrees first, and nothing else may run. Every end stops the servo; if that fails, the gateway's watchdog does.

The servo is stopped as by an emergency stop: six Stops in one call. Some SPI drivers do not release chip select between
the transfers of a call. A controller that needs this obeys only the first Stop. SPI reports nothing back, so a person
is asked whether the servo is loose.
"""

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

from gateway.errors import ConfigError, GatewayError
from gateway.model.calibration import RobotCalibration, calibration_of
from gateway.model.frames import Frame, FrameError, decode
from gateway.model.protocols import BUILT_IN
from gateway.onboard.check.table import FailedError, demand, ms_since
from gateway.onboard.computer import SELECT_BY_GPIO
from gateway.people.client.blocking import Client
from gateway.people.commands.moving import ServoMotion, consent, lying, ready, stopped_after
from gateway.people.commands.reach import Connection, me, show_differences
from gateway.people.terminal import ask, say
from gateway.words.own_command import command
from schemas import keys
from schemas.ack import Ack
from schemas.event import Event, FrameRecord
from schemas.robot import LEGS, MAX_DEG, SERVO_IDS
from schemas.telemetry import Telemetry
from schemas.words import Cause, Kind, Mode, Reason

_POLL_S: Final = 0.01
_SETPOINT_S: Final = 0.02
STREAM_S: Final = 0.3  # setpoints stream for this time before the step acts
_QUIET_S: Final = 0.15  # after this time all pending frames are sent: a leg's rate slot comes every 20 ms
_SERVO: Final = 61
"""The default servo. Its leg's Stop is the last of six in a call."""
_ANGLE_DEG: Final = 90.0
_HOLD_S: Final = 1.5
"""The pause at each angle. A servo reaches it from anywhere, and a person sees it."""
_REST_S: Final = 0.5
"""The time for some reports of currents at rest: ten a second are published."""
_LEAST_RISE_A: Final = 0.05
"""A servo draws about 8 mA at rest, and at least 100 mA while it moves."""
_PERIOD_S: Final = 0.05
"""A fifth of the default watchdog timeout."""
_HOLDS: Final = (
    "A Stop does not reach it together with others: the driver of this SPI bus does not release chip select between "
    "the transfers of one call, and of six Stops the controller obeys the first. AN EMERGENCY STOP WOULD STOP ONE LEG. "
    f"To have all stop, {SELECT_BY_GPIO}. It was now stopped alone: if it still holds, switch its power off."
)
_WHOLE_HOLDS: Final = (
    "The shutdown does not reach the controller: AN EMERGENCY STOP WOULD STOP NOTHING. Switch the servos' power off, "
    "and see that the Pi's TX leads to the controller's RX (controller.uart names the UART)."
)
# fmt: off
_BOARD, _ALL, _LEGS, _WHOLE = "board", "all", "legs", "whole"
_CAUSES: Final = (
    (_BOARD, "power.servos: did another servo move, or is one stiff? Exchange them there, and restart it."),
    (_ALL, "Supply: have the servos one of their own, and is it on? A servo that runs holds against your hand."),
    (_LEGS, "Framing: the gateway speaks {spi.framing}. The published STM32 firmware needs length-prefixed (plain "
            "makes it deaf), one that follows the protocol's document plain. Know which is there, then change it."),
    (_LEGS, "Reset: has the controller ever received the wrong framing? Then it is deaf until its reset: set the right "
            "one, restart the gateway, and reset the controller (its reset button, or power)."),
    (_LEGS, "Wiring: do MOSI, SCLK and GND lead from the Pi to the controller, and have the servos the same ground?"),
    (_LEGS, "Chip select: the gateway writes to {spi.device}; CE0 is /dev/spidev0.0, CE1 is /dev/spidev0.1."),
    (_WHOLE, "UART: does the Pi's TX lead to the controller's RX? Its heartbeat comes by the other wire."),
    (_WHOLE, "Wiring: does MOSI lead from the Pi to the controller? Its answers come by MISO, so SCLK works."),
    (_ALL, "The servo: is it plugged in at the place of its id (the leg, then the joint)? Try another one."),
)
# fmt: on
"""Why a servo may stand still although every frame was written, the likeliest first, and for which robots."""


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
    frames: list[tuple[FrameRecord, Frame]] = field(default_factory=list)
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
            self.frames.append((record, decode(bytes.fromhex(record.bytes))))

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
        ack = self.client.ask(keys.RESET, {"estop": self.estop})
        state = self.client.state()
        # The client repeats an emergency stop that has no answer after 0.2 s, and each request has a number of its own.
        if not ack.accepted and state.estop_source == self.client.name:
            ack = self.client.ask(keys.RESET, {"estop": state.estop})
        self.demand(ack, "the reset")
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

    def caused(self, cause: Cause, *, stops: bool) -> list[FrameRecord]:
        """Return the leg's frames that were written for this cause, its Stops or its motions."""
        own = ((record, frame) for record, frame in self.frames if frame.leg == self.motion.leg)
        return [record for record, frame in own if record.cause == cause and frame.is_stop is stops]

    def running(self) -> dict[int, float | None]:
        """Return the angles (degrees) of all servos that run, by id, as the gateway reports."""
        servos = (servo for leg in self.client.state().legs for servo in leg.servos)
        return {servo.id: servo.angle_deg for servo in servos if servo.running}

    def demand_no_motion(self, when: str, since: int | None = None) -> None:
        """Raise FailedError if a servo runs, or a frame since the mark (None: from now) starts or sets one."""
        since = len(self.frames) if since is None else since
        time.sleep(_QUIET_S)
        moving = [record.bytes for record, frame in self.frames[since:] if not frame.is_stop]
        demand(not moving, f"{when}, {len(moving)} frames moved a servo: {moving[:1]}")
        demand(not (running := self.running()), f"{when}, servos run: {[*running]}")


# ---- check --move


def move(connect: Connection, *, agreed: bool) -> int:
    """Ask, move, stop, and ask what was seen. Return 0 if a person saw it move, else 1.

    Raises ConfigError if nothing may be moved, FailedError if a command is rejected. `agreed`: ask nothing; 0 then
    means only that all commands were accepted.
    """
    with connect() as client:
        state = ready(client)
        show_differences()
        whole, measured = state.wire.whole_robot, list[Telemetry]()
        if whole and not state.controller.alive:
            raise ConfigError(f"the controller does not answer, and nothing is moved: {command('status')} names why")
        motion = _motion(lying(client, state) if whole else {}, agreed=agreed)
        which = "all servos are" if whole else f"{motion.which} is"
        consent(motion, state, agreed=agreed)
        state = ready(client)  # the questions took their time
        # If supply is what starts a servo, the one at that output moves, whichever it is.
        if shows_output := state.power is not None and not state.wire.supply_starts:
            _subscriber = client.on_telemetry(measured.append)
            time.sleep(_REST_S)
        at_rest = len(measured)

        def stop() -> str:  # alone in its call
            ack = client.stop() if whole else client.ask(motion.key, {"op": "stop"}, again=True)
            end = "stopped." if ack.accepted else f"not stopped: {ack.reason}: {ack.detail}"
            return f"{which.capitalize()} {end}"

        with client.lease(source=me()), stopped_after(which, stop):
            bench = Bench(client, motion)
            bench.start()  # only once: a set is rejected for what somebody else has stopped
            for angle_deg in (motion.start_deg, motion.end_deg):
                end_s = time.monotonic() + _HOLD_S
                while time.monotonic() < end_s:
                    bench.ask("set", angle_deg)
                    time.sleep(min(_PERIOD_S, state.watchdog.timeout_ms / 5000))
            bench.demand(client.stop(), "a Stop")
            if state.simulated:
                say("A simulated controller took it: no servo is there to move.")
            say(f"All six legs were stopped at once, {motion.which} with them.")
            if shows_output:
                say(output(measured[:at_rest], measured[at_rest:], motion.servo_id))
            if agreed:
                say("Every frame was written, and SPI has no way back: look whether it moved, and whether it is loose.")
                return 0
            seen = ask("Did it move? yes or no: ")
            loose = ask("Turn its horn gently with a finger: is it loose now? yes or no: ") if seen == "yes" else ""
    if seen == "no":
        say("The gateway wrote every frame, and SPI has no way back: one of these, the likeliest first.")
        of = {_ALL, _WHOLE if whole else _LEGS, _ALL if state.power is None else _BOARD}
        of -= {_LEGS, _WHOLE} if state.wire.name not in BUILT_IN else set()  # which are about SPI
        for place, text in enumerate((text for robots, text in _CAUSES if robots in of), 1):
            say(f"{place}. {text.format(spi=state.spi)}")
    if loose == "no":
        say(_WHOLE_HOLDS if whole else _HOLDS)
    if loose == "yes":
        say(f"Then everything from here to {motion.which} works.")
        if motion.leg == LEGS[0] and not whole:
            say("Its Stop was the first of six in one call: try a servo of leg 6, to see whether the others arrive.")
    return int(loose != "yes")


def output(rest: Sequence[Telemetry], moving: Sequence[Telemetry], servo_id: int) -> str:
    """Return a sentence on what the power board's currents, at rest and later, show for a servo that was moved."""

    def peak_a(reports: Sequence[Telemetry], unknown_a: float) -> float:
        servos = (each.servos.get(str(servo_id)) for each in reports if each.servos)
        return max((each.current_a for each in servos if each and each.current_a is not None), default=unknown_a)

    rise_a = peak_a(moving, 0.0) - peak_a(rest, math.inf)
    if rise_a >= _LEAST_RISE_A:
        return f"The power board's output for servo {servo_id} feeds it ({rise_a * 1000:.0f} mA more than at rest)."
    return (
        f"The power board has measured no current of servo {servo_id}: its output in power.servos feeds another "
        "servo, or none. If it did not move, see by the plugs which one it is, and exchange the two."
    )


def _motion(held: Mapping[int, float], *, agreed: bool) -> ServoMotion:
    """Ask which servo goes where. Raises ConfigError for a wrong servo or angle."""
    text = ("" if agreed else ask(f"Which servo, 11 to 63? [{_SERVO}] ")) or str(_SERVO)
    if not (text.isdigit() and int(text) in SERVO_IDS):
        raise ConfigError(f"{text!r} is no servo: the leg, 1 to 6, then the joint, 1 to 3")
    usual_deg = held.get(int(text), _ANGLE_DEG)
    angle = ("" if agreed else ask(f"Start it at which angle? [{usual_deg:g}] ")) or str(usual_deg)
    with suppress(ValueError):
        if 0 <= float(angle) <= MAX_DEG:
            return ServoMotion(int(text), float(angle), held)
    raise ConfigError(f"{angle!r} is no angle: 0 to 180 degrees")
