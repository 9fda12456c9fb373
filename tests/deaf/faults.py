"""Bytes of a recorded scene lost: what becomes of it on the simulated controller, and what that did unasked."""

import asyncio
import copy
import functools
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from gateway.model.frames import ZERO, Frame, Framing, Op, decode
from gateway.robot.spi import BatchReport, Wire
from gateway.simulation.controller import pulse_us
from schemas.robot import SERVO_IDS
from tests.deaf.minute import Message
from tests.support.controllers import Controller
from tests.support.robot import MS, Robot


class Written(NamedTuple):
    at_ns: int
    data: bytes
    repeat: bool
    """Whether it is part of a repeated run of Stops."""


class _Recorded(Robot):
    def __init__(self) -> None:
        self.log: list[Written] = []
        super().__init__({"spi": {"framing": "length-prefixed"}})

    def wire(self) -> Wire:
        bus, take, repeats = super().wire(), self.controller.take, False
        write = bus.write

        def marked(frames: Sequence[Frame], *, preamble: bool = False) -> BatchReport:
            nonlocal repeats
            repeats = preamble
            return write(frames, preamble=preamble)

        def recorded(data: bytes) -> None:
            self.log.append(Written(self.now_ns(), data, repeats and len(data) > 1))
            take(data)

        bus.write, self.controller.take = marked, recorded  # type: ignore[method-assign]
        return bus


async def recorded(messages: Iterable[Message], until_ms: float) -> list[Written]:
    """Return all transfers up to this time of a gateway that starts at 0 and receives these."""
    robot = _Recorded()
    begun_ns = robot.now_ns()
    robot.conductor.start()
    for message in messages:
        await asyncio.sleep(max(0.0, (begun_ns + message.at_ms * MS - robot.now_ns()) / 1e9))
        robot.put(message.key, message.payload)
    await asyncio.sleep((begun_ns + until_ms * MS - robot.now_ns()) / 1e9)
    robot.conductor.close()
    return [each._replace(at_ns=each.at_ns - begun_ns) for each in robot.log]


State = dict[int, int | None]
Said = tuple[Op | None, int | None]


@dataclass(slots=True)
class Watcher:
    """Call `saw` after each transfer. Times in nanoseconds."""

    controller: Controller
    fault_ns: int = 0
    missed: int = 0
    """Frames that were written and not executed as they are."""
    deaf_ns: int = 0
    """From the fault to the last of them."""
    missed_first_stops: int = 0
    misread: bool = False
    """Whether anything was executed since the fault that was not written so: at first, what half a body says."""
    stops_after_repeat: int = 0
    """Servos that were on after a repeated Stop for them: none."""
    left_on: frozenset[int] = frozenset()
    """At the end of all: the servos that only a reset or the supply's switch stops."""
    unasked: set[str] = field(default_factory=set)
    """What servos did that no frame said: started or moved, and by what."""
    _executed: int = 0
    _state: State = field(default_factory=lambda: dict.fromkeys(SERVO_IDS))
    astray: set[int] = field(default_factory=set)
    """Servos that do what no frame said."""

    def saw(self, now_ns: int, data: bytes, *, repeat: bool) -> None:
        executed, self._executed = self.controller.executed - self._executed, self.controller.executed
        if len(data) == 1 and not executed:
            return
        said = _said(data)
        before, now = self._state, pulses(self.controller)
        self._state = now
        if executed == 1 and not self.astray and now == _after(before, said):
            return
        how = "by half a body" if not self.misread else "out of sync"
        for servo_id in SERVO_IDS:
            self._compare(servo_id, before[servo_id], now[servo_id], said.get(servo_id), how)
        self.misread |= executed > 0
        if said and (executed != 1 or now != _after(before, said)):
            self.missed += 1
            self.deaf_ns = max(self.deaf_ns, now_ns - self.fault_ns)
        if said and all(op is None for op, _ in said.values()):
            on = sum(now[servo_id] is not None for servo_id in said)
            if repeat:
                self.stops_after_repeat += on
            elif on:
                self.missed_first_stops += 1

    def _compare(self, servo_id: int, before: int | None, now: int | None, said: Said | None, how: str) -> None:
        """Note whether one servo does what no frame said, or no longer does what one said."""
        op, angle_us = said or (None, None)
        if now is None or (op is not None and now == angle_us and (before is not None or op is Op.START)):
            self.astray.discard(servo_id)
        elif now != before and servo_id not in self.astray:
            self.astray.add(servo_id)
            self.unasked.add(f"{'started' if before is None else 'moved'} {how}")


def pulses(controller: Controller) -> State:
    """Return the pulse of each servo that is on; None for one that is off, whose compare value nobody sees."""
    servos = controller.servos
    return {servo_id: servos[servo_id].pulse_us if servos[servo_id].energised else None for servo_id in SERVO_IDS}


@functools.cache
def _said(data: bytes) -> dict[int, Said]:
    """Return what a frame says of its servos: the operation (None: Stop) and the pulse."""
    if len(data) == 1:
        return {}
    return {
        servo_id: (None, None) if op.op is Op.STOP else (op.op, pulse_us(*divmod(op.angle_cdeg, 100)))
        for servo_id, op in decode(data).servos
    }


def _after(before: State, said: dict[int, Said]) -> State:
    """Return what becomes of the servos as a frame says it; a Set for one that is off is not seen."""
    after = dict(before)
    for servo_id, (op, angle_us) in said.items():
        if op is not Op.SET or before[servo_id] is not None:
            after[servo_id] = angle_us
    return after


GIVEN_UP_NS = 2_000 * MS
"""By then a controller has given up a receive under way."""


Clock = list[int]
"""The time (ns) of all controllers of a log; no copy of one has another."""


class Fault(NamedTuple):
    """Where bytes are lost in a row, over the ends of transfers."""

    transfer: int
    position: int
    lost: int

    def received(self, log: list[Written]) -> dict[int, bytes]:
        """Return the transfers that it changes, by their place in the log."""
        changed, position, lost = {}, self.position, self.lost
        for index in range(self.transfer, len(log)):
            data = log[index].data
            changed[index] = data[:position] + data[position + lost :]
            lost -= min(lost, len(data) - position)
            position = 0
            if lost == 0:
                break
        return changed


def lose_bytes(
    log: list[Written], *, every: int = 1, tick_phase_ns: int = 0, run: int = 1, since_ns: int = 0
) -> list[Watcher]:
    """Lose a run from each byte on that is written from then on; with `every`, from one in so many."""
    places = [
        Fault(index, position, run)
        for index, written in enumerate(log)
        if written.at_ns >= since_ns
        for position in range(len(written.data))
    ]
    return list(_played(log, places[every - 1 :: every], tick_phase_ns))


def lose_transfers(log: list[Written], *, every: int) -> dict[str, list[Watcher]]:
    """Lose transfers, by what they are: one of each kind in so many."""
    faults: defaultdict[str, list[Fault]] = defaultdict(list)
    for index, written in enumerate(log):
        faults[_kind(written.data)].append(Fault(index, 0, len(written.data)))
    return {kind: list(_played(log, places[every - 1 :: every])) for kind, places in faults.items()}


def _kind(data: bytes) -> str:
    return "a zero" if data == ZERO else "an announcement" if len(data) == 1 else "a body"


def _played(log: list[Written], faults: Iterable[Fault], tick_phase_ns: int = 0) -> Iterator[Watcher]:
    """Watch each fault to its end. Faults come in the log's order."""
    clock = [0]
    controller = Controller(Framing.LENGTH_PREFIXED, clock=lambda: clock[0], tick_phase_ns=tick_phase_ns)
    watcher = Watcher(controller)
    states = _states(log, clock, copy.deepcopy(controller))
    played = 0
    for fault in faults:
        for written in log[played : fault.transfer]:
            clock[0] = written.at_ns
            controller.take(written.data)
            watcher.saw(written.at_ns, written.data, repeat=written.repeat)
        played = fault.transfer
        clock[0] = log[played].at_ns
        controller.transfers.clear()
        faulty: Watcher = copy.deepcopy(watcher)
        faulty.fault_ns = clock[0]
        faulty.left_on = _play_on(log, fault, states, clock, faulty)
        faulty.controller.transfers.clear()
        yield faulty
    assert not watcher.missed, "without a fault, all is executed"


def _states(log: list[Written], clock: Clock, controller: Controller) -> list[State]:
    states: list[State] = []
    for written in log:
        clock[0] = written.at_ns
        executed = controller.executed
        controller.take(written.data)
        states.append(pulses(controller) if controller.executed > executed or not states else states[-1])
    return states


def _play_on(log: list[Written], fault: Fault, states: list[State], clock: Clock, watcher: Watcher) -> frozenset[int]:
    """Play the rest with that fault, until nothing is left of it, or of the controller.

    Returns the servos that nothing stops any more, where something should.
    """
    controller, received = watcher.controller, fault.received(log)
    for place in range(fault.transfer, len(log)):
        at_ns, data, repeat = log[place]
        clock[0] = at_ns
        controller.take(received.get(place, data))
        if controller.dead is not None:
            return controller.energised
        watcher.saw(at_ns, data, repeat=repeat)
        whole = len(data) > 1 and place >= max(received)
        if whole and not controller.missing and not watcher.astray and pulses(controller) == states[place]:
            return frozenset()
    clock[0] += GIVEN_UP_NS
    return controller.energised - {servo_id for servo_id, pulse in states[-1].items() if pulse is not None}
