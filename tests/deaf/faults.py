"""Bytes of a recorded scene lost: what becomes of it on the simulated controller."""

import copy
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from gateway.model.framing import ZERO, Framing
from tests.deaf.recorded import Written
from tests.deaf.watcher import State, Watcher, pulses
from tests.support.controllers import Controller
from tests.support.robot import MS

GIVEN_UP_NS = 2_000 * MS
"""By then a controller has given up a receive under way."""


@dataclass(slots=True)
class Tally:
    """What became of some faults."""

    faults: int = 0
    without_effect: int = 0
    missed_first_stops: int = 0
    stops_after_repeat: int = 0
    """Servos that were on after a repeated Stop for them: none."""
    deaf_ms: float = 0.0
    corruptions: int = 0
    on_for_good: int = 0
    """Faults after which servos are on that only a reset or the supply's switch stops."""
    dead: int = 0
    unasked: set[str] = field(default_factory=set)

    def add(self, watcher: Watcher, left_on: frozenset[int]) -> None:
        """A fault that has been watched to its end."""
        self.faults += 1
        self.without_effect += not (watcher.missed or watcher.unasked)
        self.missed_first_stops += watcher.missed_first_stops
        self.stops_after_repeat += watcher.stops_after_repeat
        self.deaf_ms = max(self.deaf_ms, watcher.deaf_ns / MS)
        self.corruptions += watcher.controller.corruptions.total()
        self.on_for_good += bool(left_on)
        self.dead += watcher.controller.dead is not None
        self.unasked |= watcher.unasked


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


def lose_bytes(log: list[Written], *, every: int = 1, tick_phase_ns: int = 0, run: int = 1, since_ns: int = 0) -> Tally:
    """Lose a run from each byte on that is written from then on; with `every`, from one in so many."""
    places = (
        (index, position)
        for index, written in enumerate(log)
        if written.at_ns >= since_ns
        for position in range(len(written.data))
    )
    tally = Tally()
    faults = (Fault(*place, run) for number, place in enumerate(places, 1) if number % every == 0)
    for _, watcher, left_on in _played(log, faults, tick_phase_ns):
        tally.add(watcher, left_on)
    return tally


def lose_transfers(log: list[Written], *, every: int) -> dict[str, Tally]:
    """Lose transfers, by what they are: one of each kind in so many."""
    numbers: Counter[str] = Counter()
    faults = []
    for index, written in enumerate(log):
        kind = _kind(written.data)
        numbers[kind] += 1
        if numbers[kind] % every == 0:
            faults.append(Fault(index, 0, len(written.data)))
    tallies: dict[str, Tally] = {kind: Tally() for kind in numbers}
    for fault, watcher, left_on in _played(log, faults):
        tallies[_kind(log[fault.transfer].data)].add(watcher, left_on)
    return tallies


def _kind(data: bytes) -> str:
    return "a zero" if data == ZERO else "an announcement" if len(data) == 1 else "a body"


def _played(
    log: list[Written], faults: Iterable[Fault], tick_phase_ns: int = 0
) -> Iterator[tuple[Fault, Watcher, frozenset[int]]]:
    """Each fault, watched to its end, and the servos that nothing stops any more. Faults come in the log's order."""
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
        left_on = _play_on(log, fault, states, clock, faulty)
        yield fault, faulty, left_on
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
