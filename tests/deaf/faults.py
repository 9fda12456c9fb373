"""Bytes of a minute lost once, each gap stretched once: what becomes of it on the simulated controller."""

import copy
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import NamedTuple

from gateway.model.frames import ONE_LEG_LEN, ONE_SERVO_LEN
from gateway.model.framing import ZERO, Framing
from gateway.robot.spi.simulator import SimulatedController
from tests.deaf.minute import Message, minute, stopped_walk
from tests.deaf.scene import BEGIN_NS, MS, Scene, Written
from tests.deaf.watcher import State, Watcher, pulses

END_NS = BEGIN_NS + 60_500 * MS
AFTER_NS = 2_000 * MS
"""How long a scene is watched after a stall: twice what a stream may take."""
STOPS_MS = (2_000, 2_137, 2_274, 2_411)
"""When a scene's emergency stop comes: at several places of a step, and between messages."""
BEFORE_STOP_NS = 300 * MS
STOPS_NS = 66 * MS
"""An emergency stop's first Stops and its three repeats are written within this time."""
REST_NS = 5_000 * MS
"""How long a scene goes on after an emergency stop: until nothing more is written."""
STALLS_MS = (900, 1100, 3000)
_SOME_BYTES = re.compile(r"^\d+ bytes in ")


@dataclass(slots=True)
class Tally:
    """What became of some faults."""

    faults: int = 0
    without_effect: int = 0
    missed: int = 0
    most_missed: int = 0
    """Frames of one fault."""
    missed_first_stops: int = 0
    stops_after_repeat: list[str] = field(default_factory=list)
    """Where a Stop was not executed even with its first repeat: nowhere."""
    left_on: list[str] = field(default_factory=list)
    """Where a servo was on in the end that the gateway takes as stopped: nowhere."""
    deaf_ms: float = 0.0
    deaf_longest: str = ""
    corruptions: int = 0
    on_for_good: int = 0
    """Faults of bytes after which servos are on that only a reset or the supply's switch stops."""
    left_on_alive: int = 0
    """Of these, those whose controller is alive: it would execute a Stop, but nobody writes one."""
    dead: Counter[str] = field(default_factory=Counter)
    """What the controller died of, and how often."""
    unasked: Counter[str] = field(default_factory=Counter)
    unasked_ms: dict[str, list[float]] = field(default_factory=dict)

    def add(self, where: str, place: str, watcher: Watcher) -> None:
        """A fault that has been watched to its end; `place` is what it hit."""
        self.faults += 1
        self.without_effect += not (watcher.missed or watcher.unasked)
        self.missed += watcher.missed
        self.most_missed = max(self.most_missed, watcher.missed)
        self.missed_first_stops += watcher.missed_first_stops
        if watcher.stops_after_repeat:
            self.stops_after_repeat.append(f"{where}: {watcher.stops_after_repeat[:3]}")
        if watcher.deaf_ns / MS > self.deaf_ms:
            self.deaf_ms, self.deaf_longest = watcher.deaf_ns / MS, where
        for _, what, duration_ns in watcher.unasked:
            self.unasked_ms.setdefault(f"{what}, {place}", []).append(duration_ns / MS)
        self.unasked.update({f"{what}, {place}" for _, what, _ in watcher.unasked})

    def count(self, log: list[Written], fault: "Fault", watcher: Watcher, left_on: frozenset[int]) -> None:
        """What became of a fault of bytes."""
        data = log[fault.transfer].data
        if watcher.controller.dead is not None:
            self.dead[_SOME_BYTES.sub("", watcher.controller.dead)] += 1
        self.on_for_good += bool(left_on)
        self.left_on_alive += bool(left_on) and watcher.controller.dead is None
        self.corruptions += watcher.controller.corruptions.total()
        where = f"byte {fault.position} of [{data.hex()}], transfer {fault.transfer}"
        self.add(where, fault.place(data), watcher)

    @property
    def text(self) -> str:
        lines = [
            f"{self.faults} faults, {self.without_effect} without effect",
            f"  frames missed {self.missed} (at most {self.most_missed} of a fault),"
            f" of them first Stops {self.missed_first_stops}, repeated Stops {len(self.stops_after_repeat)}",
            f"  longest deaf {self.deaf_ms:.0f} ms ({self.deaf_longest}); servos left on {len(self.left_on)};"
            f" corruptions {self.corruptions}; controllers dead {self.dead.total()};"
            f" servos on for good {self.on_for_good}, with a controller that is alive {self.left_on_alive}",
        ]
        for what, count in sorted(self.unasked.items()):
            times_ms = sorted(self.unasked_ms[what])
            lines.append(
                f"  {what}: {count} faults, {len(times_ms)} servos,"
                f" for {times_ms[len(times_ms) // 2]:.0f} ms (median), {times_ms[-1]:.0f} ms (longest)"
            )
        lines += [f"  dead: {why}, {count} faults" for why, count in self.dead.most_common(5)]
        return "\n".join([*lines, *self.stops_after_repeat[:5], *self.left_on[:5]])


class _Clock:
    now_ns = BEGIN_NS

    def __call__(self) -> int:
        return self.now_ns


def recorded(messages: list[Message] | None = None, end_ns: int = END_NS) -> list[Written]:
    """A scene as it was written, without a fault; by default the minute."""
    scene = Scene(minute() if messages is None else messages)
    scene.run_until(end_ns)
    return scene.log


class Fault(NamedTuple):
    """Where bytes are lost in a row, over the ends of transfers; 0: the first of them is doubled."""

    transfer: int
    position: int
    lost: int

    def place(self, data: bytes) -> str:
        """What it hits first."""
        if self.lost > 1:
            return f"{self.lost} bytes lost"
        fault = "lost" if self.lost else "doubled"
        return f"{'of a body' if len(data) > 1 else _kind(data)} {fault}"

    def received(self, log: list[Written]) -> dict[int, bytes]:
        """The transfers that it changes, by their place in the log."""
        data = log[self.transfer].data
        if self.lost == 0:
            return {self.transfer: data[: self.position + 1] + data[self.position :]}
        changed, position, lost = {}, self.position, self.lost
        for index in range(self.transfer, len(log)):
            data = log[index].data
            changed[index] = data[:position] + data[position + lost :]
            lost -= min(lost, len(data) - position)
            position = 0
            if lost == 0:
                break
        return changed


class BoundedController(SimulatedController):
    """A firmware with the check of docs/protocol.md: it takes no other length than a frame's."""

    def _expect(self, length: int, now_ns: int) -> None:
        if length in (ONE_SERVO_LEN, ONE_LEG_LEN):
            super()._expect(length, now_ns)


def lose_bytes(
    log: list[Written],
    *,
    every: int = 1,
    first: int = 0,
    tick_phase_ns: int = 0,
    doubled: bool = False,
    run: int = 1,
    controller: type[SimulatedController] = SimulatedController,
) -> Tally:
    """Lose each byte once, or double it, or lose a run from each byte on; with `every`, from one in so many."""
    places = ((index, position) for index, written in enumerate(log) for position in range(len(written.data)))
    faults = (
        Fault(index, position, 0 if doubled else run)
        for number, (index, position) in enumerate(places, 1)
        if (number - first) % every == 0
    )
    tally = Tally()
    for fault, watcher, left_on in _played(log, faults, tick_phase_ns, controller):
        tally.count(log, fault, watcher, left_on)
    return tally


def lose_transfers(log: list[Written], *, every: int = 1, tick_phase_ns: int = 0) -> dict[str, Tally]:
    """Lose each transfer once, by what it is; with `every`, one of each kind in so many."""
    numbers: Counter[str] = Counter()
    faults = []
    for index, written in enumerate(log):
        kind = _kind(written.data)
        numbers[kind] += 1
        if numbers[kind] % every == 0:
            faults.append(Fault(index, 0, len(written.data)))
    tallies: dict[str, Tally] = {kind: Tally() for kind in numbers}
    for fault, watcher, left_on in _played(log, iter(faults), tick_phase_ns):
        tallies[_kind(log[fault.transfer].data)].count(log, fault, watcher, left_on)
    return tallies


def lose_before_stop(run: int, *, every: int = 1) -> Tally:
    """Lose a run from each byte on of the 0.3 s before an emergency stop, in a stream of six legs at 50 Hz."""
    return _lose_around_stops(run, -BEFORE_STOP_NS, 0, every=every)


def lose_in_stops(
    run: int, *, every: int = 1, stops_ms: tuple[int, ...] = STOPS_MS, end_ns: int = REST_NS
) -> tuple[Tally, Tally]:
    """Lose a run from each byte on of an emergency stop's first Stops and their repeats, and of the runs behind them.

    Nothing is written any more once `end_ns` has passed since the emergency stop.
    """
    first = _lose_around_stops(run, 0, STOPS_NS, every=every, stops_ms=stops_ms, end_ns=end_ns)
    return first, _lose_around_stops(run, STOPS_NS, end_ns, every=every, stops_ms=stops_ms, end_ns=end_ns)


def _lose_around_stops(
    run: int,
    from_ns: int,
    until_ns: int,
    *,
    every: int,
    stops_ms: tuple[int, ...] = STOPS_MS,
    end_ns: int = REST_NS,
) -> Tally:
    """Lose a run from each byte on that is written between these times, counted from an emergency stop."""
    tally = Tally()
    for stop_ms in stops_ms:
        stop_ns = BEGIN_NS + stop_ms * MS
        log = recorded(stopped_walk(stop_ms), stop_ns + end_ns)
        faults = (
            Fault(index, position, run)
            for index, written in enumerate(log)
            if stop_ns + from_ns <= written.at_ns < stop_ns + until_ns
            for position in range(len(written.data))
        )
        for fault, watcher, left_on in _played(log, islice(faults, 0, None, every)):
            tally.count(log, fault, watcher, left_on)
    return tally


def _played(
    log: list[Written],
    faults: Iterator[Fault],
    tick_phase_ns: int = 0,
    kind: type[SimulatedController] = SimulatedController,
) -> Iterator[tuple[Fault, Watcher, frozenset[int]]]:
    """Each fault, watched to its end, and the servos that nothing stops any more. Faults come in the log's order."""
    clock = _Clock()
    controller = kind(Framing.LENGTH_PREFIXED, clock=clock, tick_phase_ns=tick_phase_ns)
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


def _kind(data: bytes) -> str:
    return "a zero" if data == ZERO else "an announcement" if len(data) == 1 else "a body"


def _states(log: list[Written], clock: _Clock, controller: SimulatedController) -> list[State]:
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
            watcher.end(clock.now_ns)
            return controller.energised
        watcher.saw(at_ns, data, repeat=repeat)
        whole = len(data) > 1 and place >= max(received)
        if whole and not controller.missing and not watcher.astray and pulses(controller) == states[place]:
            watcher.end(clock.now_ns)
            return frozenset()
    watcher.end(clock.now_ns)
    clock.now_ns += AFTER_NS  # a receive under way is given up
    return controller.energised - {servo_id for servo_id, pulse in states[-1].items() if pulse is not None}


def stretch_gaps(
    *,
    every: int = 1,
    first: int = 0,
    stalls_ms: tuple[float, ...] = STALLS_MS,
    tick_phase_ns: int = 0,
) -> dict[float, Tally]:
    """Let the machine stall once before each call of the minute; with `every`, before one in so many.

    Within a call it cannot: the transfers of a call leave together.
    """
    tallies = {stall_ms: Tally() for stall_ms in stalls_ms}
    for before, number in _moments(every, first, tick_phase_ns):
        for stall_ms, tally in tallies.items():
            scene = before.copy()
            scene.stall_at(number, round(stall_ms * MS))
            scene.run_until(before.loop.clock_ns + round(stall_ms * MS) + AFTER_NS)
            scene.watcher.end(scene.loop.clock_ns)
            where = f"transfer {number}"
            tally.add(where, "after a stall", scene.watcher)
            tally.corruptions += scene.controller.corruptions.total()
            running = {servo.servo_id for servo in scene.conductor.supervisor.legs.servos.values() if servo.running}
            if not scene.controller.energised <= running:
                tally.left_on.append(f"{where}: {sorted(scene.controller.energised - running)}")
    return tallies


def _moments(every: int, first: int, tick_phase_ns: int) -> Iterator[tuple[Scene, int]]:
    """A scene just before the step whose call begins with the transfer of that number, for each that is wanted.

    The minute is always the same, so a first run of it says which steps those are; a copy takes longer than a step.
    """
    ahead, scene = (Scene(minute(), tick_phase_ns=tick_phase_ns) for _ in range(2))
    calls = 0
    while ahead.loop.clock_ns < END_NS:
        ahead.calls.clear()
        if not ahead.step():
            break
        wanted = [number for place, number in enumerate(ahead.calls, calls) if (place - first) % every == 0]
        calls += len(ahead.calls)
        if wanted:
            before = scene.copy()
            yield from ((before, number) for number in wanted)
        scene.step()
