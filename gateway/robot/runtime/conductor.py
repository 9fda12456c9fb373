"""Takes what came in, asks the supervisor, writes the frames, answers and tells.

Everything here is called by the owner of the state (`robot.host.ownership`), on whatever thread. Nothing waits but a
transfer.
"""

import asyncio
import logging
from collections.abc import Callable, Iterable
from typing import Final

from gateway import __version__
from gateway.errors import SpiError
from gateway.robot.blackbox.recorder import NO_RECORDER, Recorder, Written
from gateway.robot.core.calibration_intake import CalibrationIntent
from gateway.robot.core.events import (
    Announce,
    BusFailed,
    BusOpened,
    ButtonRequest,
    Calibrate,
    Command,
    Completed,
    Effect,
    EmergencyStop,
    Event,
    Kept,
    LeaseRequest,
    Rejected,
    Reset,
    ShutDown,
    StoppedOutside,
    TimePassed,
    Transmit,
)
from gateway.robot.core.intake import Rejection, echo_of, intent_of
from gateway.robot.core.losses import DETAIL, Losses
from gateway.robot.core.message import Outbox, Received, Reply, Verb
from gateway.robot.core.staleness import Staleness
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.core.targets import Intent
from gateway.robot.host.ownership import Ownership, OwnersTimer
from gateway.robot.runtime.answers import Answers, legs_of
from gateway.robot.runtime.event_publisher import Teller
from gateway.robot.runtime.metrics import Metrics
from gateway.robot.runtime.preamble import PreambleInPauses
from gateway.robot.runtime.report import limits_of, report
from gateway.robot.runtime.sources import Sources
from gateway.robot.settings import Settings
from gateway.robot.spi.bus import Bus
from schemas import keys, telemetry
from schemas.robot import LEGS
from schemas.telemetry import Ack, Cause, Kind, Mode, Reason

REOPEN_S: Final = 0.02
"""Well within the 100 ms of docs/interface.md, Behaviour 6, and never longer: until the Stops behind the opening are
written, nobody knows that a leg is stopped."""

_LOST, _REPEAT = Verb.LOST, Cause.REPEAT  # see `frames.OP_STOP`

logger = logging.getLogger(__name__)


class Conductor:
    """One robot's gateway, from received messages to written frames."""

    def __init__(
        self,
        settings: Settings,
        supervisor: Supervisor,
        bus: Bus,
        outbox: Outbox,
        loop: asyncio.AbstractEventLoop,
        *,
        clock: Callable[[], int],
        simulated: bool,
        physics: str | None = None,
        recorder: Recorder = NO_RECORDER,
        owner: Ownership | None = None,
    ) -> None:
        """`physics`: Zenoh id of the process that simulates the robot's body, if one does."""
        self._settings = settings
        self._limits = limits_of(settings)
        self.supervisor = supervisor
        self.bus = bus
        self._loop = loop
        self.owner = owner or Ownership()
        """Whoever calls anything here holds it."""
        self._clock = clock
        self._simulated = simulated
        self._physics = physics
        self._started_ns = self._instant_ns = clock()
        self._sources = Sources()
        self._losses = Losses()
        self._staleness = Staleness(settings.limits.max_age_ms) if settings.limits.max_age_ms else None
        self._timer = OwnersTimer(loop, self.owner, self.tick)
        self._reopen_timer = OwnersTimer(loop, self.owner, self._reopen)
        self._in_fault = False
        self._announced = self._closed = False
        self._preamble = PreambleInPauses(bus, loop, self.owner, clock, self._after)
        self._told_mode = Mode.STARTING
        self.done = asyncio.Event()
        """Set once, after `shut_down`, nothing is left to send: the Stops and their repeats are written."""
        self.metrics = Metrics()
        self.outbox = outbox
        self.recorder = recorder
        self._teller = Teller(outbox, recorder)
        self._tell = self._teller.event
        self.answers = Answers(self.metrics, recorder, self._sources, self._tell, clock)
        self._pending, self._numbers = self.answers.pending, self.answers.numbers
        self.take: Callable[[], Iterable[Received]] = tuple
        """Where messages come from; the service connects the inbox here once everything stands."""
        self.calibration_kept = False
        """Whether the calibration outlasts this process."""
        self.certificate: telemetry.CertificateReport | None = None
        """Of those in use, the first that expires."""
        self.instant_open: Callable[[], bool] = lambda: False
        """Whether the next messages are of the same instant as the last; the inbox, as well."""

    # ---- start and end

    def start(self) -> None:
        """Open the bus, write the preamble, stop all six legs. Raises SpiError."""
        self.bus.open()
        fault = self._carry_out(self.supervisor.step(BusOpened(), self._clock()))[1]
        if fault is not None:
            raise fault
        self._arm()

    def announce_start(self) -> None:
        """Tell that commands are taken from now on."""
        self._announced = True
        self._tell(Kind.STARTED, f"hexapod-gateway {__version__} takes commands")
        self._tell_mode()

    def announce(self, kind: Kind, detail: str, key: str | None = None) -> None:
        """Publish what happened beside the robot's own state."""
        self._tell(kind, detail, None, key)

    def shut_down(self) -> bool:
        """Reject all commands from now on, and stop all six legs: whether all Stops were written without a fault."""
        self._reopen_timer.cancel()
        if self.supervisor.mode is Mode.BUS_FAULT:
            self._reopen()  # a last attempt: the Stops below are worth it
        stop_frames = _count(self._step(ShutDown()), Cause.SHUTDOWN)
        self._arm()
        return stop_frames >= len(LEGS) and not self._in_fault

    def close(self) -> None:
        """Release the bus and the timers. A receiver thread that becomes owner after that does nothing."""
        self._closed = True
        for timer in (self._timer, self._reopen_timer, self._preamble):
            timer.cancel()
        self.bus.close()

    # ---- what happens

    def tick(self, only: tuple[Received, ...] | None = None) -> None:
        """Take what came in and do what is due. A tick is (part of) an instant: nobody knows the order of what came.

        `only` these messages, if given: what waits in the rings belongs to a later instant.
        """
        if self._closed:
            return
        now_ns = self.turned()
        instant_ns = self._instant_ns = self._instant_ns if self.instant_open() else now_ns
        looked = False
        for received in self.take() if only is None else only:
            self._receive(received, instant_ns)
            self._do_what_is_due(instant_ns)  # a full tick takes long enough for a deadline to pass in it
            looked = True
        if self._losses.key:
            self._stop_what_lost_stops_named(instant_ns)
            looked = False
        if not looked:
            self._do_what_is_due(instant_ns)
        self._arm()

    def turned(self) -> int:
        """To be called by each owner before it takes a message, and ten times a second at least. What time it is.

        Whichever thread is the first to go on after the whole process was stopped thus notices it.
        """
        now_ns = self._clock()
        if self._staleness is not None:
            self._staleness.turned(now_ns)
        return now_ns

    def _do_what_is_due(self, instant_ns: int) -> None:
        if self.supervisor.due_ns is not None and self._clock() >= self.supervisor.due_ns:
            self._step(TimePassed(), instant_ns)

    def answer_state(self, reply: Reply) -> None:
        """Answer a `get` on the state."""
        reply(self.state().model_dump_json().encode())

    def _receive(self, received: Received, instant_ns: int) -> None:
        if self._losses.key and (received.key != self._losses.key or received.verb is Verb.GET):
            self._stop_what_lost_stops_named(instant_ns)
        if received.key == keys.ESTOP:
            self._emergency_stop(received, instant_ns)
            return
        if received.verb is _LOST:
            self._losses.note(received.key)
            self.metrics.overflows += 1
            self.metrics.lost += received.size
            return
        intent = intent_of(received)
        if isinstance(intent, Rejection):
            self.answers.reject(
                echo_of(received.expression), received.source, received.reply, intent.reason, intent.detail
            )
            return
        source = intent.source or received.source
        now_ns = self._clock()
        too_old = self.too_old(intent, source, now_ns, instant_ns)
        if too_old is not None:
            self.recorder.command(0, received.verb, received.key, source, intent, received.received_ns)
            self.answers.reject(received.key, source, received.reply, Reason.STALE, too_old, servos=intent.targets)
            return
        self._pending[number := next(self._numbers)] = received.key, source, received.reply, intent.targets
        self.recorder.command(number, received.verb, received.key, source, intent, received.received_ns)
        if received.key == keys.RESET:
            self._step(Reset(number, source, received.key, intent.estop, intent.lease), instant_ns)
        else:
            command = Command(number, received.channel, intent.targets, source, intent.lease)
            self._step(command, instant_ns, now_ns)
            if self._losses.key and self.answers.rejected != number:
                self._losses.accepted(intent.targets)

    def ask(self, event: LeaseRequest | ButtonRequest | Calibrate | Kept) -> list[Effect]:
        """Let the supervisor take what commands nothing that moves. Returns its effects, which are carried out."""
        if self._closed:
            return []
        effects = self.supervisor.step(event, self._clock())
        self._after(self._carry_out(effects)[1])
        return effects

    def _stop_what_lost_stops_named(self, instant_ns: int) -> None:
        key, targets = self._losses.take()
        stops = tuple(stop for stop in targets if self.supervisor.legs.servos[stop[0]].will_run)
        if stops:
            self._pending[number := next(self._numbers)] = key, None, None, stops
            self._step(Command(number, f"put {key}", stops, lost=True), instant_ns)
            overflow = Announce(Kind.OVERFLOW, DETAIL, None, key, legs_of(stops), Reason.OVERFLOW)
            self._sources.announce(overflow, self._clock(), self._tell)

    def too_old(
        self, intent: Intent | CalibrationIntent, source: str | None, now_ns: int, instant_ns: int
    ) -> str | None:
        """Why a command was, or may have been, delayed for too long; None: it was not."""
        if self._staleness is None:
            return None
        too_old = self._staleness.too_old(source, intent.sent_ms, now_ns, instant_ns)
        # A Stop is taken however old it is: to stop once too often harms nobody.
        return None if too_old is None or intent.only_stops else too_old

    def _emergency_stop(self, received: Received, instant_ns: int) -> None:
        # Nothing of the payload is looked at before the Stops: whatever it is, somebody wants the robot to stop.
        self._sources.note_estop(received)
        if self.supervisor.mode is Mode.BUS_FAULT:
            self._reopen()
        stop_frames = _count(self._step(EmergencyStop(received.source, received.key), instant_ns), Cause.ESTOP)
        latency_ns = max(0, self._clock() - received.received_ns)
        self.recorder.command(0, received.verb, received.key, self._sources.estop, Intent(), received.received_ns)
        if stop_frames >= len(LEGS):
            self.metrics.emergency_stops.record(latency_ns)
        if received.reply is not None:
            number = self.supervisor.estops
            ack = Ack(accepted=True, stop_frames=stop_frames, estop=number, latency_us=latency_ns / 1000)
            received.reply(ack.model_dump_json().encode())

    def _step(self, event: Event, instant_ns: int | None = None, now_ns: int | None = None) -> list[Written]:
        """Let the supervisor take an event and carry out what it says. Returns the frames that were written."""
        now_ns = self._clock() if now_ns is None else now_ns
        written, fault = self._carry_out(self.supervisor.step(event, now_ns, instant_ns))
        if fault is not None:
            self._bus_failed(fault)
        self._tell_mode()
        return written

    def _carry_out(self, effects: list[Effect]) -> tuple[list[Written], SpiError | None]:
        """Do what the supervisor wants: its frames first, as batches, then what is to be answered and published."""
        written: list[Written] = []
        self.recorder.step, self.recorder.told = written, 0
        transmits = [effect for effect in effects if type(effect) is Transmit]
        fault = self._transmit(transmits, written) if transmits else None
        for effect in effects:
            match effect:
                case Completed() if fault is not None:
                    self.answers.reject_pending(
                        effect.number, Reason.BUS_FAULT, f"the frame could not be written: {fault}"
                    )
                case Completed():
                    self.answers.accept(effect)
                case Rejected():
                    self.answers.reject_pending(effect.number, effect.reason, effect.detail)
                case Announce(kind=Kind.BUS_RECOVERED) if fault is not None:
                    pass  # it opened, but did not take six Stops: the fault goes on, and has been told
                case Announce():
                    self._sources.announce(effect, self._clock(), self._tell)
        self.recorder.frames()
        if self._settings.telemetry.frames:
            self._teller.frames(written)
        return written, fault

    def _transmit(self, transmits: list[Transmit], written: list[Written]) -> SpiError | None:
        """Write a step's frames: first Stops in one batch, repeated ones in one, then what moves, unless one failed."""
        for batch in _batches(transmits):
            report = self.bus.write([effect.frame for effect in batch], preamble=batch[0].cause is _REPEAT)
            for sent in report.sent:
                effect = batch[sent.place]
                written.append(Written(sent.data, effect.cause, sent.ns, sent.call_ns, effect.deadline_ns, sent.heard))
                self.metrics.frames[effect.cause] += 1
                self.answers.wrote(effect)
                if effect.deadline_ns is not None and sent.heard:
                    self.metrics.watchdog_stops.record(self.bus.ended_ns - effect.deadline_ns)
            if report.rejection is not None:
                self._tell(Kind.BUS_UNBATCHED, report.rejection, None, None, None)
            if report.fault is not None:
                return report.fault
        if len(written) > 1:
            self.recorder.frames()
        return None

    # ---- the bus

    def _bus_failed(self, fault: SpiError) -> None:
        self.bus.close()
        effects = self.supervisor.step(BusFailed(str(fault)), self._clock())
        if self._in_fault:
            effects = [effect for effect in effects if not isinstance(effect, Announce)]
        self._in_fault = True
        self._carry_out(effects)
        if self.supervisor.mode is Mode.BUS_FAULT:
            self._reopen_later()

    def _after(self, fault: SpiError | None) -> None:
        if fault is not None:
            self._bus_failed(fault)
        self._tell_mode()
        self._arm()

    def _reopen_later(self) -> None:
        self._reopen_timer.set(self._loop.time() + REOPEN_S)

    def _reopen(self) -> None:
        try:
            self.bus.open()
        except SpiError as error:
            logger.debug("the SPI device does not answer yet: %s", error)
            self._reopen_later()
            return
        self._step(BusOpened())
        if self.supervisor.mode is not Mode.BUS_FAULT:
            self._in_fault = False
            self._reopen_timer.cancel()
        self._arm()

    def look_outside(self) -> None:
        """Learn of `stop-servos` on the same device, and of its end."""
        at_work = self.bus.stop_servos_at_work()
        if at_work is not self.supervisor.stopped_outside:
            self._step(StoppedOutside(at_work))
            self._arm()

    # ---- time

    def _arm(self) -> None:
        """Wake up when the supervisor wants to."""
        due_ns = self.supervisor.due_ns
        if self.bus.announces:
            due_ns = self._preamble.arm(due_ns, None if due_ns is None else self.supervisor.legs.repeat_ns)
        if due_ns is None:
            if self.supervisor.mode is Mode.STOPPING:
                self._loop.call_soon_threadsafe(self.done.set)
            self._timer.cancel()
        else:
            self._timer.set(due_ns / 1e9)

    # ---- answers and reports

    def _tell_mode(self) -> None:
        mode = self.supervisor.mode
        if self._announced and mode is not self._told_mode:  # until then it is starting, however long that takes
            self._told_mode = mode
            self.recorder.mode(mode)
            logger.info("mode %s", mode, extra={"mode": mode})
            self.outbox.publish(keys.STATE, self.state())

    def state(self) -> telemetry.GatewayState:
        """What the gateway knows now."""
        return report(
            self._settings,
            self.supervisor,
            self.bus,
            self.metrics,
            started_ns=self._started_ns,
            now_ns=self._clock(),
            simulated=self._simulated,
            physics=self._physics,
            estop_source=self._sources.estop,
            incident=self.recorder.incident,
            calibration_kept=self.calibration_kept,
            certificate=self.certificate,
            limits=self._limits,
        )


def _batches(transmits: list[Transmit]) -> list[list[Transmit]]:
    """What leaves together, in order. A repeated run of Stops has a preamble, for which no first Stop waits."""
    if len(transmits) == 1:
        return [transmits]
    stops = [effect for effect in transmits if effect.frame.is_stop]
    first = [effect for effect in stops if effect.cause is not _REPEAT]
    repeated = [effect for effect in stops if effect.cause is _REPEAT]
    moves = [effect for effect in transmits if not effect.frame.is_stop]
    return [batch for batch in (first, repeated, moves) if batch]


def _count(written: list[Written], cause: Cause) -> int:
    return sum(frame.heard and frame.cause is cause for frame in written)
