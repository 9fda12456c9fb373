"""Bytes of a recorded scene lost: what becomes of it on the simulated controller."""

import copy
from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from gateway.model.framing import ZERO, Framing
from tests.deaf.recorded import Written
from tests.deaf.watcher import State, Watcher, pulses
from tests.support.controllers import Controller
from tests.support.robot import MS

GIVEN_UP_NS = 2_000 * MS
"""By then a controller has given up a receive under way."""


class _Clock:
    now_ns = 0

    def __call__(self) -> int:
        return self.now_ns


class Fault(NamedTuple):
    """Where bytes are lost in a row, over the ends of transfers."""

    transfer: int
    position: int
    lost: int

    def received(self, log: list[Written]) -> dict[int, bytes]:
        """The transfers that it changes, by their place in the log."""
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
    clock = _Clock()
    controller = Controller(Framing.LENGTH_PREFIXED, clock=clock, tick_phase_ns=tick_phase_ns)
    watcher = Watcher(controller)
    states = _states(log, clock, copy.deepcopy(controller, {id(clock): clock}))
    played = 0
    for fault in faults:
        for written in log[played : fault.transfer]:
            clock.now_ns = written.at_ns
            controller.take(written.data)
            watcher.saw(written.at_ns, written.data, repeat=written.repeat)
        played = fault.transfer
        clock.now_ns = log[played].at_ns
        controller.transfers.clear()
        faulty: Watcher = copy.deepcopy(watcher, {id(clock): clock})
        faulty.fault_ns = clock.now_ns
        faulty.left_on = _play_on(log, fault, states, clock, faulty)
        faulty.controller.transfers.clear()
        yield faulty
    assert not watcher.missed, "without a fault, all is executed"


def _states(log: list[Written], clock: _Clock, controller: Controller) -> list[State]:
    """The servos after each transfer."""
    states: list[State] = []
    for written in log:
        clock.now_ns = written.at_ns
        executed = controller.executed
        controller.take(written.data)
        states.append(pulses(controller) if controller.executed > executed or not states else states[-1])
    return states


def _play_on(log: list[Written], fault: Fault, states: list[State], clock: _Clock, watcher: Watcher) -> frozenset[int]:
    """Play the rest with that fault, until nothing is left of it, or of the controller.

    Returns the servos that nothing stops any more, where something should.
    """
    controller, received = watcher.controller, fault.received(log)
    for place in range(fault.transfer, len(log)):
        at_ns, data, repeat = log[place]
        clock.now_ns = at_ns
        controller.take(received.get(place, data))
        if controller.dead is not None:
            return controller.energised
        watcher.saw(at_ns, data, repeat=repeat)
        whole = len(data) > 1 and place >= max(received)
        if whole and not controller.missing and not watcher.astray and pulses(controller) == states[place]:
            return frozenset()
    clock.now_ns += GIVEN_UP_NS
    return controller.energised - {servo_id for servo_id, pulse in states[-1].items() if pulse is not None}
