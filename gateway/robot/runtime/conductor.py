"""Takes received messages, asks the supervisor, and has its effects carried out. Reopens the bus, and keeps the timer.

The owner of the state (`robot.host.ownership`) makes all calls here, on any thread. Only a transfer waits.
"""

import asyncio
import logging
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, field
from itertools import count
from typing import Final

from gateway.errors import ControllerRestartedError, ControllerSilentError, SpiError
from gateway.model.elkapod import Measured
from gateway.model.frames import legs_of
from gateway.model.staleness import Staleness
from gateway.robot.blackbox.recorder import Recorder
from gateway.robot.core.events import (
    Announce,
    BodyMeasured,
    BusFailed,
    BusOpened,
    Command,
    EmergencyStop,
    Event,
    Rejected,
    Request,
    ShutDown,
    StoppedOutside,
    Targets,
    TimePassed,
)
from gateway.robot.core.intake import LOST, not_started, read, stops_in, stops_of
from gateway.robot.core.message import Messages, Outbox, Received, Verb
from gateway.robot.core.rejections import Rejection, echo_of
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.host.ownership import Ownership, OwnersTimer
from gateway.robot.power.board import Confirmed, News
from gateway.robot.power.line import PowerLine
from gateway.robot.runtime.executor import Executor, Outcome
from gateway.robot.runtime.report import RobotReports, wall_clock
from gateway.robot.runtime.supply import RobotSupply, off_button
from gateway.robot.settings import Settings
from gateway.robot.spi import Wire
from schemas.ack import Ack
from schemas.keys import COMMAND_KEYS
from schemas.robot import LEGS, SERVO_IDS
from schemas.words import Cause, Kind, Mode, Reason

REOPEN_S: Final = 0.02
"""Pause between two attempts to open a failed device. It does not grow: until the device is open and Stops are written,
it is not known whether the legs are stopped. The first attempt comes at once, since after a fault a controller needs
the preamble ahead of these Stops (docs/protocol.md), and no pause."""

LATE_S: Final = 0.2
"""How late a beat may be on a busy machine."""
_KINDS: Final[dict[type[SpiError], Kind]] = {
    ControllerSilentError: Kind.CONTROLLER_SILENT,
    ControllerRestartedError: Kind.CONTROLLER_RESTARTED,
}
"""The event that reports a fault; every other fault is a BUS_FAULT."""
_LOST: Final = Verb.LOST  # see `frames.OP_STOP`

logger = logging.getLogger(__name__)


@dataclass(eq=False)
class Conductor:
    """One robot's gateway, from received messages to written frames."""

    settings: Settings
    supervisor: Supervisor
    bus: Wire
    outbox: Outbox
    loop: asyncio.AbstractEventLoop
    _: KW_ONLY
    clock: Callable[[], int]
    """Returns the monotonic time in ns."""
    recorder: Recorder
    owner: Ownership = field(default_factory=Ownership)
    """Callers own the state while they call."""
    line: PowerLine | None = None
    """The power board's, to be started after this; None: there is no board."""

    def __post_init__(self) -> None:
        settings, supervisor, bus, line = self.settings, self.supervisor, self.bus, self.line
        self.supply = None if line is None else RobotSupply(line, supervisor, bus)
        if line is not None:
            line.on_news = self._power_changed_soon
        self.messages = Messages()
        """Where received messages come from."""
        self.reports = RobotReports(
            settings, supervisor, bus, line, self.outbox, self.recorder, self.clock, lambda: self.messages.passed_over
        )
        self.metrics = self.reports.metrics
        self.executor = Executor(bus, self.supply, self.reports, publish_frames=settings.telemetry.frames)
        self._instant_ns = self.clock()  # mutants accepted (Forget): no instant is open before the first
        self.numbers = count(1)
        """The numbers of requests to the supervisor."""
        self._lost_key = ""
        """The key whose messages are handled after a loss, else ""."""
        self._lost_stops: Targets = ()
        self._staleness = Staleness(settings.limits.max_age_ms) if settings.limits.max_age_ms else None
        self._announces = bus.announces  # read for each setpoint
        self._timer = OwnersTimer(self.loop, self.owner, self._wake)
        self._reopen_timer = OwnersTimer(self.loop, self.owner, self._reopen)
        self._preamble_timer = OwnersTimer(self.loop, self.owner, self._write_preamble)
        self._in_fault = False
        self.closed = False
        """Whether the conductor is closed and writes nothing more."""
        self._engaged = 0  # the number of the emergency stop; 0: none is engaged
        self.on_latch: Callable[[], None] = lambda: None
        """Called as owner when an emergency stop has been engaged, after its Stops, or left."""
        self.on_mode: Callable[[], object] = lambda: None
        """Called as owner when the mode has changed, after the step's frames."""
        self.done = asyncio.Event()
        """Set after `shut_down`, once the Stops and their repeats are written."""

    # ---- start and end

    def start(self) -> None:
        """Open the bus, write the preamble, stop all six legs. Raises SpiError if any of that fails."""
        self.bus.open()
        outcome = self._decide(BusOpened(), self.clock())
        self.recorder.follow(self.supervisor)
        if outcome.fault is not None:
            raise outcome.fault
        if outcome.meddled is not None:
            self._meddled(outcome.meddled, None)
        self._check_stop_servos()
        self._arm()

    def shut_down(self) -> bool:
        """Reject all further commands and stop all six legs. Return whether all Stops were written."""
        if self.supervisor.mode is Mode.BUS_FAULT:
            self._reopen()  # a last attempt, so that the Stops below can be written
        stop_frames = self._step(ShutDown()).stop_frames(Cause.SHUTDOWN)
        return stop_frames >= len(LEGS) and not self._in_fault

    def close(self) -> None:  # mutants accepted (LeaveOut): after the end a tick does nothing
        """Release the bus and the timers. A receiver thread that becomes owner afterwards does nothing."""
        self.closed = True
        for timer in (self._timer, self._reopen_timer, self._preamble_timer):
            timer.cancel()
        if self.supply is not None:
            self.supply.close()
        self.bus.close()

    # ---- what happens

    def tick(self) -> None:
        """Take the received messages and do what is due.

        A tick is an instant or a part of one: the order of an instant's messages is unknown.
        """
        if self.closed:
            return
        messages, received = self.messages, None
        if not messages.instant_open:
            self._instant_ns = self.clock()
        instant_ns = self._instant_ns
        for received in messages.take():
            if messages.estops:
                self._serve_estops(instant_ns)
            self._receive(received, instant_ns)
            self._do_what_is_due(instant_ns)  # a full tick takes long enough for a deadline to pass in it
        if messages.estops:
            self._serve_estops(instant_ns)
        if self._lost_key:
            self._stop_what_lost_stops_named(instant_ns)
        if received is None:
            self._do_what_is_due(instant_ns)

    def _wake(self) -> None:
        """Do what is due. Each step sets the timer; a timer that was early, with nothing to do, is set again."""
        if not self.closed:
            self.tick()
            self._arm()

    def serve_estops(self) -> None:
        """Carry out emergency stops without a tick. Messages that wait in the rings belong to a later instant."""
        if not self.closed and self.messages.estops:
            if not self.messages.instant_open:
                self._instant_ns = self.clock()
            self._serve_estops(self._instant_ns)

    def _serve_estops(self, instant_ns: int) -> None:
        while self.messages.estops:
            self._emergency_stop(self.messages.estops.popleft(), instant_ns)

    def rests(self, gap_s: float) -> bool:
        """Return whether nothing needs a beat within `gap_s`.

        Nothing runs, neither a board nor a wire with cycles can fall silent, and a beat that is late by up to LATE_S
        does not look like a pause of the process.
        """
        if self.supervisor.mode is not Mode.IDLE or self.supply is not None or self.bus.cycle is not None:
            return False
        return self._staleness is None or (gap_s + LATE_S) * 1000 <= self._staleness.pause_ms

    def record_alive(self) -> int:
        """Return now (ns) and record that the process runs. Call it at each beat: a gap shows that it did not."""
        now_ns = self.clock()
        if self._staleness is not None:
            self._staleness.record_alive(now_ns)
        return now_ns

    def ask(self, event: Event) -> Outcome:
        """Let the supervisor take an event that moves no servo. Return the outcome; it is empty once closed."""
        return Outcome() if self.closed else self._step(event)

    def too_old(self, request: Request, now_ns: int, instant_ns: int) -> str | None:
        """Return why a request was, or may have been, delayed for too long, or None if it was not."""
        judge = self._staleness
        return None if judge is None else judge.too_old(request.source, request.sent_ms, now_ns, instant_ns)

    def check_outside(self) -> None:  # mutants accepted (Forget): a tick too many does nothing
        """Check for `stop-servos` on the same device, changed settings, and stopped servos that draw current."""
        if self.supply is not None:
            if self.supply.judge_currents(self.clock()):
                self._power_changed_soon(())
            battery_mv = self.supply.battery_mv
            if battery_mv is not None and self.supervisor.body.watches and not self.settings.wire.measures:
                self._step(BodyMeasured(None, battery_mv))
        silent = self.bus.silent(self.clock())  # here, too: a transfer that hangs keeps the cycle from this check
        if silent is not None:
            self.bus_failed(silent)
        meddled = self.bus.put_right()
        if meddled is not None:
            self._meddled(meddled, None)
            return  # the check for `stop-servos` follows once the device is open again
        self._check_stop_servos()

    def _check_stop_servos(self) -> None:
        """Report a start or an end of `stop-servos` to the supervisor. A closed device shows neither."""
        at_work = self.bus.stop_servos_at_work()
        if at_work is not None and at_work is not self.supervisor.outside.closed:
            self._step(StoppedOutside(at_work))

    def measured(self, values: Measured, now_ns: int) -> None:
        """Take the measurements of one well-formed answer of the controller, received at `now_ns`."""
        if self.closed:
            return
        self.reports.newest = values, now_ns
        self.recorder.measured(values, now_ns)
        if self.supply is not None:
            self.supply.feed_ready()  # the frame may contain the angle of a servo that is to be powered
        if self.supervisor.body.watches:
            tilt_cdeg = None if values.tilt_deg is None else round(values.tilt_deg * 100)
            self._step(BodyMeasured(tilt_cdeg, round(values.voltage_v * 1000)))

    def _power_changed_soon(self, news: Sequence[News | Confirmed]) -> None:
        """Let the loop wait for the state, since the board's receiving thread must not."""
        with suppress(RuntimeError):  # the loop is closed: the service has ended
            self.loop.call_soon_threadsafe(self.power_changed, news)

    def power_changed(self, news: Sequence[News | Confirmed]) -> None:
        """Take the changes that the power board has reported. The only call here that makes its caller the owner."""
        with self.owner:
            if self.closed or self.supply is None:
                return
            event, announcements = self.supply.take_news(news)
            self._step(event)
            for each in announcements:
                self.reports.announce(each)
            if any(each.kind is Kind.OFF_BUTTON for each in announcements):
                self._emergency_stop(off_button(self.clock()), self.clock())
            self.reports.publish()

    def _do_what_is_due(self, instant_ns: int) -> None:
        due_ns = self.supervisor.due_ns
        if due_ns is not None and self.clock() >= due_ns:
            self._step(TimePassed(), instant_ns)

    def _receive(self, received: Received, instant_ns: int) -> None:
        if self._lost_key and (received.key != self._lost_key or received.verb is Verb.GET):
            self._stop_what_lost_stops_named(instant_ns)
        if received.verb is _LOST:
            self._lost_key, self._lost_stops = received.key, stops_of(COMMAND_KEYS[received.key])
            self.metrics.overflows += 1
            self.metrics.lost += received.size
            return
        command = read(received)
        if type(command) is Rejection:
            self._reject_unread(received, command, instant_ns)
            return
        now_ns = self.clock()
        judge = self._staleness
        too_old = None if judge is None else judge.too_old(command.source, command.sent_ms, now_ns, instant_ns)
        if too_old is not None and not command.only_stops:  # a late Stop does no harm
            if type(command) is not Command or not command.stops:
                self.executor.reject(command, Reason.STALE, too_old, command)
                return
            command.rejected = Rejected(command, Reason.STALE, too_old)
        command.number = next(self.numbers)
        try:
            if type(command) is Command and (frames := self.supervisor.usual(command, now_ns, instant_ns)) is not None:
                outcome = self.executor.carry_out_usual(frames, command, now_ns, instant_ns)
                if outcome is not None:
                    self._after_fault(outcome)
                if self._announces:
                    self._arm()  # for the preamble
            else:
                outcome = self._step(command, instant_ns, now_ns)
        except Exception:
            self.recorder.broke((command, now_ns, instant_ns))
            raise
        if self._lost_key and (outcome is None or not outcome.rejects(command)):
            self._lost_stops = not_started(self._lost_stops, command.targets)

    def _reject_unread(self, received: Received, why: Rejection, instant_ns: int) -> None:
        """Reject a message that could not be read. Carry out the Stops that it may contain."""
        unread = Request(key=echo_of(received.expression), reply=received.reply)
        unread.source = unread.source_id = received.source
        stops = stops_in(received)
        if not stops:
            self.executor.reject(unread, why.reason, why.detail)
            return
        command = Command(stops, key=received.key, verb=received.verb, received_ns=received.received_ns)
        command.source = command.source_id = received.source
        command.rejected = Rejected(unread, why.reason, why.detail)
        command.number = unread.number = next(self.numbers)
        unread.received_ns = received.received_ns
        self._step(command, instant_ns)

    def _stop_what_lost_stops_named(self, instant_ns: int) -> None:
        key, self._lost_key = self._lost_key, ""
        stops = tuple(stop for stop in self._lost_stops if self.supervisor.legs.servos[stop[0]].will_run)
        if stops:
            command = Command(stops, key=key, number=next(self.numbers), lost=True)
            self._step(command, instant_ns)
            legs = legs_of(command.servo_ids)
            self.reports.announce(Announce(Kind.OVERFLOW, LOST, None, key, legs, Reason.OVERFLOW))

    def _emergency_stop(self, received: Received, instant_ns: int) -> None:
        # The payload is read after the Stops: even a malformed one means that somebody wants the robot to stop.
        self.reports.estop = received
        if self.supervisor.mode is Mode.BUS_FAULT:
            self._reopen()
        event = EmergencyStop(received.source, received.key, received.source)
        stop_frames = self._step(event, instant_ns).stop_frames(Cause.ESTOP)
        latency_ns = max(0, self.clock() - received.received_ns)
        request = Request(
            key=received.key,
            source=self.reports.estop_source,
            verb=received.verb,
            received_ns=received.received_ns,
            reply=received.reply,
        )
        self.recorder.request(request)
        if stop_frames >= len(LEGS):
            self.metrics.emergency_stops.record(latency_ns)
        number = self.supervisor.latch.number
        ack = Ack(accepted=True, stop_frames=stop_frames, estop=number, latency_us=latency_ns / 1000)
        self.executor.answer(request, ack, SERVO_IDS)

    def _step(self, event: Event, instant_ns: int | None = None, now_ns: int | None = None) -> Outcome:
        """Let the supervisor take an event, and carry out its effects."""
        now_ns = self.clock() if now_ns is None else now_ns
        outcome = self._decide(event, now_ns, instant_ns)
        self._after_fault(outcome)
        self._settle()
        return outcome

    def _decide(self, event: Event, now_ns: int, instant_ns: int | None = None) -> Outcome:
        taken = event, now_ns, now_ns if instant_ns is None else instant_ns
        try:
            return self.executor.carry_out(self.supervisor.step(*taken), taken)
        except Exception:
            self.recorder.broke(taken)
            raise

    def _after_fault(self, outcome: Outcome) -> None:
        if outcome.meddled is not None:
            self._meddled(outcome.meddled, outcome.fault)
        elif outcome.fault is not None:
            self.bus_failed(outcome.fault)

    def _settle(self) -> None:
        """Publish a change of the emergency stop (its Stops are written) or of the mode, and set the timer."""
        latch, reports = self.supervisor.latch, self.reports
        engaged = 0 if latch.since_ns is None else latch.number
        if self._engaged != engaged:
            self._engaged = engaged
            reports.estop_since = reports.estop_since or wall_clock() if engaged else None
            self.on_latch()
        if self.supervisor.mode is not reports.published_mode:
            reports.publish_mode()
            self.on_mode()
        self._arm()

    # ---- the bus

    # mutants accepted (AndWithOr, Step): one effect; a time that is over
    def bus_failed(self, fault: SpiError) -> None:
        """Handle a bus fault: of a step, or found outside one."""
        if self.closed:
            return
        self.bus.release()
        kind = _KINDS.get(type(fault), Kind.BUS_FAULT)
        now_ns = self.clock()
        failed = BusFailed(str(fault), kind)
        effects = self.supervisor.step(failed, now_ns)
        again, self._in_fault = self._in_fault, True
        if again and kind is not Kind.CONTROLLER_SILENT:
            effects = [each for each in effects if not (isinstance(each, Announce) and each.kind is kind)]
        self.executor.carry_out(effects, (failed, now_ns, now_ns))
        if self.supervisor.mode is Mode.BUS_FAULT:
            self._reopen_timer.set_in(REOPEN_S if again else 0)
        self._settle()

    def _meddled(self, found: str, fault: SpiError | None) -> None:
        """Report changed device settings, and handle a bus fault: the controller may not have understood the frames.

        `fault` is that of the step which found them. Without it, no fault is needed after a reopening or at the end of
        the service. There, Stops for all legs have just been written with the right settings, and at the end nothing
        would reopen the bus for their repeats.
        """
        self.reports.announce(Announce(Kind.BUS_MEDDLED, found))
        if fault is not None:
            self.bus_failed(fault)
        elif not self._in_fault and self.supervisor.mode is not Mode.STOPPING:
            self.bus_failed(SpiError(found))

    def _reopen(self) -> None:
        try:
            self.bus.open()
        except SpiError as error:
            # mutants accepted (Forget): a line in the log
            logger.debug("the SPI device does not answer yet: %s", error)
            self._reopen_timer.set_in(REOPEN_S)
            return
        self._check_stop_servos()  # before commands: otherwise its next Stop would undo a start unnoticed
        self._step(BusOpened())
        if self.supervisor.mode is not Mode.BUS_FAULT:
            self._in_fault = False
            self._reopen_timer.cancel()

    # ---- time, and the preamble

    def _arm(self) -> None:  # mutants accepted (Forget, Step): a tick too many does nothing; a time that is over
        """Set the timers for what is due next."""
        due_ns, bus = self.supervisor.due_ns, self.bus
        if self._announces:
            preamble_ns = self._preamble_ns()
            if not self._preamble_timer.armed and (bus.resync_due or self._is_due(preamble_ns)):
                self._preamble_timer.set_in(0)  # on the loop, so that other owners get the state between two parts
            if due_ns is not None and preamble_ns is not None and not self._preamble_timer.armed:
                due_ns = min(due_ns, preamble_ns)
        if due_ns is None:
            if self.supervisor.mode is Mode.STOPPING:
                self.loop.call_soon_threadsafe(self.done.set)
            self._timer.cancel()
        else:
            self._timer.set(due_ns / 1e9)

    def _is_due(self, due_ns: int | None) -> bool:
        return due_ns is not None and self.clock() >= due_ns

    def _preamble_ns(self) -> int | None:
        """Return when to write the preamble of repeated Stops, or None if none is due or it is written."""
        repeat_ns, bus = self.supervisor.legs.stops.due_ns, self.bus
        return None if repeat_ns is None or bus.just_resynchronised else repeat_ns - bus.preamble_ns

    def _write_preamble(self) -> None:  # mutants accepted (Step): a time that is over
        """Write a part of the preamble in a pause of a stream; the loop runs between the parts.

        A preamble in parts delays a Stop by one part at most, and is complete before Stops are repeated. Without a
        pause, the bus writes it ahead of a frame.
        """
        bus = self.bus
        if not (bus.resync_due or self._is_due(self._preamble_ns())):
            self._arm()  # a frame was written meanwhile, with its preamble
            return
        try:
            if bus.write_zeros():
                self._preamble_timer.set_in(0)
        except SpiError as fault:
            self.bus_failed(fault)
