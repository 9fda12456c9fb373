"""Carries out the effects of a supervisor's step, and answers each request once. Only a transfer waits."""

import logging
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Literal

from gateway.errors import SpiError
from gateway.model.black_box import COALESCED
from gateway.model.frames import Frame, legs_of
from gateway.robot.blackbox.recorder import Taken, Written
from gateway.robot.core.events import (
    Announce,
    Command,
    Effect,
    Request,
    RequestAnswer,
    Result,
    SaveCalibration,
    Sender,
    Transmit,
    Verdict,
    batches,
    results,
)
from gateway.robot.core.legs import moves_of
from gateway.robot.core.message import Reply
from gateway.robot.core.rejections import echo_of
from gateway.robot.runtime.report import RobotReports
from gateway.robot.runtime.supply import RobotSupply
from gateway.robot.spi import BatchReport, Wire
from gateway.words.text import legs_named
from schemas.ack import Ack
from schemas.words import Cause, Kind, Reason

logger = logging.getLogger(__name__)

_COMMAND, _LEGS_STOPPED = Cause.COMMAND, Kind.LEGS_STOPPED
"""Read for each effect; see `frames.OP_STOP`."""


@dataclass(slots=True)
class Outcome:
    """A step's result: its frames, the requests that it ended, and what its caller has to do."""

    effects: Sequence[Effect] = ()
    written: list[Written] = field(default_factory=list)
    fault: SpiError | None = None
    """Why some frames were not written. The commands of those frames are rejected."""
    unwritten: Sequence[int] = ()
    """The legs of frames that the controller has not received because of the fault."""
    meddled: str | None = None
    """The device settings that another program had changed, found just before these frames were written."""
    results: list[Result] = field(default_factory=list)
    """The requests that the step has ended, for the black box, the answers and the metrics."""

    @property
    def to_do(self) -> RequestAnswer | SaveCalibration | None:
        """The answer that the caller has to send, or the calibration that it has to write to the disk."""
        return next((each for each in self.effects if isinstance(each, RequestAnswer | SaveCalibration)), None)

    def rejects(self, request: Request) -> bool:
        """Return whether the step has rejected this request. A pending request is not rejected."""
        return any(each is request and type(verdict) is Reason for each, verdict, _ in self.results)

    def stop_frames(self, cause: Cause) -> int:
        """Return how many frames with this cause are known to have left for the controller."""
        return sum(sent.received and transmit.cause is cause for transmit, sent in self.written)


@dataclass(slots=True)
class Executor:
    """Carries out effects, and answers each request once. For the owner of the state.

    Answers to Stops wait until the power board (`supply`) confirms them. None: there is no board.
    """

    bus: Wire
    supply: RobotSupply | None
    reports: RobotReports
    publish_frames: bool
    when_kept: Callable[[int, Callable[[bool], None]], None] | None = None
    """Calls back once the disk has the emergency stop of this number. None: no disk keeps it."""
    halts: list[Announce] = field(default_factory=list)
    """Events of stopped legs. After a fault they wait for the Stops with which the bus opens again."""
    _follows: bool = field(init=False)
    """Whether each written frame concerns others: a power board, or clients to which frames are published."""

    def __post_init__(self) -> None:
        self._follows = self.supply is not None or self.publish_frames

    # ---- the answers

    def answer(self, request: Request, ack: Ack, stopped: Collection[int] = ()) -> None:
        """Answer a request, if its sender waits; if it has stopped servos, once the power board has confirmed that."""
        reply = request.reply
        if reply is None:
            return
        if self.supply is None or not stopped:
            self._reply(reply, ack)
            return

        def confirmed(ms: float | None) -> None:
            found = {"confirmed": ms is not None, "confirmed_ms": ms}
            self._reply(reply, ack.model_copy(update=found))

        self.supply.confirm(stopped, request.received_ns, confirmed)

    def _reply(self, reply: Reply, ack: Ack) -> None:
        """Send an answer; that of an emergency stop once the disk has it, or is too slow."""
        if ack.estop is None or self.when_kept is None:
            reply(ack.model_dump_json().encode())
        else:
            self.when_kept(
                ack.estop, lambda kept: reply(ack.model_copy(update={"kept": kept}).model_dump_json().encode())
            )

    def reject_unread(self, key: str, sender: Sender, detail: str, reason: Reason = Reason.INVALID) -> None:
        """Reject a message on a key that takes no commands: an unknown key, or a key for `get` only."""
        self.reject(Request(key=echo_of(key), source=sender[0], source_id=sender[1]), reason, detail)

    def reject(self, request: Request, reason: Reason, detail: str, received: Request | None = None) -> None:
        """Reject a message before the supervisor decides. `received` is its command, if it could be read."""
        self.reports.recorder.request(received, ((request, reason, detail),))
        self._end(request, reason, detail)

    def _end(self, request: Request, verdict: Verdict, detail: str) -> None:
        """Count and answer an ended request, and publish a rejection."""
        metrics = self.reports.metrics
        if type(verdict) is not Reason:
            if isinstance(request, Command) and request.lost:
                return  # no client sent it
            coalesced = verdict == COALESCED
            metrics.accepted += 1
            metrics.coalesced += coalesced
            if request.reply is not None:
                stopped = tuple(request.servo_ids) if request.only_stops else ()
                self.answer(request, Ack(accepted=True, coalesced=coalesced or None), stopped)
            return
        written = sorted(set(request.written))
        if written:
            detail = f"{detail}; the command's frames for {legs_named(written)} were already written"
        metrics.rejected[verdict] += 1
        stops: Literal[True] | None = True if request.stopped else None
        ack = Ack(accepted=False, reason=verdict, detail=detail, written=written or None, stopped=stops)
        self.answer(request, ack, request.stopped)
        legs = legs_of(request.servo_ids)
        source, source_id = request.sender
        rejected = Announce(Kind.COMMAND_REJECTED, detail, source, request.key, legs, verdict, source_id=source_id)
        self.reports.announce(rejected)

    # ---- the effects

    def carry_out(self, effects: Sequence[Effect], taken: Taken) -> Outcome:
        """Write the frames in batches, then record, answer and publish. Return the outcome.

        `taken` is what led to them. The power board cuts servos before the frames, and powers servos after them.
        """
        supply = self.supply
        if supply is not None:
            supply.before_frames(effects)
        outcome = self._write(effects)
        self._end_all(outcome, taken)
        for effect in effects:
            if type(effect) is not Announce:
                continue
            if effect.kind is _LEGS_STOPPED:
                self.halts.append(effect)
            elif (event := effect.outcome(outcome.unwritten, outcome.fault)) is not None:
                self.reports.announce(event)
        if self.halts and outcome.written and outcome.fault is None:
            halts, self.halts = self.halts, []
            for each in halts:
                self.reports.announce(each)
        if self.publish_frames:
            self.reports.frames(outcome.written)
        if supply is not None:
            supply.after_frames(effects, fault=outcome.fault is not None)
        return outcome

    def carry_out_usual(
        self, frames: Sequence[Frame], command: Command, now_ns: int, instant_ns: int
    ) -> Outcome | None:
        """Do what `carry_out` does with the frames of `Supervisor.usual`. Return None if nothing is left to do."""
        if self._follows or self.halts:
            return self.carry_out(moves_of(command, frames), (command, now_ns, instant_ns))
        report = self.bus.write(frames)
        if report.fault is not None or report.meddled is not None or report.rejection is not None:
            outcome = Outcome(moves := moves_of(command, frames))
            self._record(moves, report, outcome)
            self._judge(outcome)
            self._end_all(outcome, (command, now_ns, instant_ns))
            return outcome
        reports = self.reports
        metrics = reports.metrics
        metrics.frames[_COMMAND] += len(frames)
        metrics.accepted += 1
        reports.recorder.carried_out(command, now_ns, instant_ns, frames, report.sent[0])
        if command.reply is not None:
            self.answer(command, Ack(accepted=True))
        return None

    def _end_all(self, outcome: Outcome, taken: Taken) -> None:
        """Record a step, and end its requests."""
        self.reports.recorder.step(taken, outcome.written, outcome.results)
        for result in outcome.results:
            self._end(*result)

    def _write(self, effects: Sequence[Effect]) -> Outcome:
        """Write a step's frames. Stop at the first fault."""
        outcome = Outcome(effects)
        first, repeated, moves = batches(effects)
        for batch in first, repeated, moves:
            if batch and outcome.fault is None:
                report = self.bus.write([transmit.frame for transmit in batch], preamble=batch is repeated)
                self._record(batch, report, outcome)
        self._judge(outcome)
        return outcome

    def _record(self, batch: Sequence[Transmit], report: BatchReport, outcome: Outcome) -> None:
        """Count the frames that were written, and add the batch's report to the outcome."""
        for sent in report.sent:
            for transmit in batch[sent.first : sent.first + sent.frames]:
                outcome.written += [(transmit, sent)]
                self.reports.metrics.frames[transmit.cause] += 1
                for command in transmit.commands:
                    command.written += (transmit.frame.leg,)
                if transmit.deadline_ns is not None and sent.received:
                    self.reports.metrics.watchdog_stops.record(sent.ns - transmit.deadline_ns)
        if report.rejection is not None:
            logger.warning("%s; from now on, each transfer is a separate call", report.rejection)
        outcome.meddled = report.meddled or outcome.meddled
        outcome.fault = report.fault

    def _judge(self, outcome: Outcome) -> None:
        """Find the requests that the step has ended. A fault rejects the commands whose frames were not received."""
        failed: list[Transmit] = []
        if outcome.fault is not None:
            received = {id(transmit) for transmit, sent in outcome.written if sent.received}
            failed = [each for each in outcome.effects if type(each) is Transmit and id(each) not in received]
            outcome.unwritten = [each.frame.leg for each in failed]
        why = f"the frame could not be written: {outcome.fault}" if failed else ""
        outcome.results = results(outcome.effects, failed, why)
        for request, _, _ in outcome.results if failed else ():
            request.stopped = ()
